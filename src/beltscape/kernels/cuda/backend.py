"""The CUDA back end: plans of launches for the kernels that it has, and the native back end for all others."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

from numpy.typing import NDArray

from beltscape.kernels.backend import Backend, gpu_failures
from beltscape.kernels.cuda import (
    images,
    least_squares,
    networks,
    photometry,
    pixels,
    planes,
    selection,
    sweep,
)
from beltscape.kernels.cuda.device import GpuDevice
from beltscape.kernels.cuda.graphs import GraphCache
from beltscape.kernels.cuda.memory import DeviceArray, DeviceError
from beltscape.kernels.cuda.workspace import Traffic, Workspace, open_workspace
from beltscape.kernels.resident import ResidentArray, as_host

Plan = Callable[[Workspace, Any, Sequence[NDArray[Any]]], Sequence[DeviceArray]]
"""Uploads a record, launches kernels and returns the results; they have the shapes and types of the last argument."""


def _has_no_limit(_: Any) -> bool:
    return True


class _Kernel(NamedTuple):
    plan: Plan
    is_within_limits: Callable[[Any], bool] = _has_no_limit


_KERNELS: dict[str, _Kernel] = {
    "sweep": _Kernel(sweep.sweep, sweep.can_sweep),
    "aggregate": _Kernel(sweep.aggregate),
    "sweep_and_aggregate": _Kernel(sweep.sweep_and_aggregate, sweep.can_sweep),
    "spline_coefficients": _Kernel(images.spline_coefficients),
    "warp": _Kernel(least_squares.warp),
    "gather": _Kernel(images.gather, images.can_gather),
    "inverse_depth_buffers": _Kernel(images.inverse_depth_buffers),
    "visible": _Kernel(images.visible),
    "normal_equations": _Kernel(least_squares.normal_equations, least_squares.can_sum_equations),
    "local_fit": _Kernel(least_squares.local_fit),
    "propagate": _Kernel(selection.propagate, selection.can_select),
    "candidate_surfaces": _Kernel(selection.candidate_surfaces),
    "photo_consistency": _Kernel(selection.photo_consistency, selection.can_select),
    "evaluate_network": _Kernel(networks.evaluate_network, networks.can_evaluate),
    "evaluate_network_of_programs": _Kernel(networks.evaluate_network_of_programs, networks.can_evaluate),
    "pass_messages": _Kernel(networks.pass_messages, networks.can_evaluate),
    "exchange_messages": _Kernel(networks.exchange_messages, networks.can_exchange),
    "evaluate_expression": _Kernel(planes.evaluate_expression),
    "average_windows": _Kernel(planes.average_windows),
    "measure_moments": _Kernel(planes.measure_moments),
    "find_extremes": _Kernel(planes.find_extremes),
    "median_of_windows": _Kernel(planes.median_of_windows),
    "measure_distances": _Kernel(planes.measure_distances),
    "average_areas": _Kernel(planes.average_areas),
    "average_blocks": _Kernel(planes.average_blocks),
    "repeat_blocks": _Kernel(planes.repeat_blocks),
    "subsample_plane": _Kernel(planes.subsample_plane),
    "interpolate_plane": _Kernel(planes.interpolate_plane),
    "filter_plane": _Kernel(planes.filter_plane),
    "find_quantile": _Kernel(planes.find_quantile),
    "average_plane": _Kernel(planes.average_plane),
    "measure_contrast": _Kernel(photometry.measure_contrast),
    "make_levels": _Kernel(photometry.make_levels),
    "measure_sharpness": _Kernel(photometry.measure_sharpness),
    "measure_phases": _Kernel(photometry.measure_phases),
    "list_pixels": _Kernel(pixels.list_pixels),
    "put_pixels": _Kernel(pixels.put_pixels),
    "assign_addresses": _Kernel(pixels.assign_addresses),
    "pick_best": _Kernel(pixels.pick_best),
}

KERNELS = tuple(_KERNELS)
"""What the device computes; other kernels run on the CPU."""


class CudaBackend:
    """Kernels on a device; the native back end takes what the device lacks, and everything once it has failed."""

    def __init__(self, device: GpuDevice, native: Backend) -> None:
        self.name = device.name
        self.failure: str | None = None
        """Why the device is no longer used."""
        self.traffic = Traffic()
        self.graphs = GraphCache(device, self.traffic)
        self.resident = ResidentBackend(self, device, native)
        """The same kernels, whose results stay on the device."""
        self._device = device
        self._native = native

    def run(
        self, kernel: str, given: Sequence[Any], out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """See `beltscape.kernels.backend.Backend`."""
        if self.failure is None and (plan := find_plan(kernel, given)):
            try:
                with open_workspace(self._device, self.traffic) as work:
                    for result, array in zip(plan(work, given, out), out, strict=True):
                        work.download(result, array)
                return out
            except DeviceError as error:
                self.give_up(error)
        return self._native.run(kernel, as_host(given), out, threads)

    def give_up(self, error: DeviceError) -> None:
        """Note that the device failed, with a warning at the first time."""
        if self.failure is None:
            self.failure = str(error)
            gpu_failures.note(self.failure)
            self.graphs.clear()
            warnings.warn(
                f"the GPU is no longer used, the processor takes over: {error}", RuntimeWarning, stacklevel=3
            )


class ResidentBackend:
    """Kernels whose results stay on the device until NumPy reads them; a device that fails raises DeviceError."""

    pixels_at_once = 1 << 18
    """Pixels that a call takes together: a GPU needs many, while a processor's cache holds few."""

    def __init__(self, whole: CudaBackend, device: GpuDevice, native: Backend) -> None:
        self.name = device.name
        self._whole = whole
        self._device = device
        self._native = native

    def run(
        self, kernel: str, given: Sequence[Any], out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """See `beltscape.kernels.backend.Backend`; the results are resident arrays."""
        plan = find_plan(kernel, given)
        if plan is None:
            return self._native.run(kernel, as_host(given), out, threads)
        with open_workspace(self._device, self._whole.traffic) as work:
            results = plan(work, given, out)
        return [cast("NDArray[Any]", ResidentArray.from_device(each, self)) for each in results]

    def find_plan(self, kernel: str, given: Any) -> Plan | None:
        """See `find_plan`."""
        return find_plan(kernel, given)

    def replay(self, function: Callable[..., Any], given: Sequence[Any]) -> Any:
        """See `beltscape.kernels.Kernels.replay`."""
        return self._whole.graphs.replay(self, function, given)

    def keep(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return an array that is copied to the device once, at its first use; it becomes read-only."""
        if isinstance(array, ResidentArray):
            array.mark_reused()
            return array
        return cast("NDArray[Any]", ResidentArray.from_host(array, self))

    def give_up(self, error: DeviceError) -> None:
        """See `CudaBackend.give_up`."""
        self._whole.give_up(error)

    def upload(self, array: NDArray[Any]) -> DeviceArray:
        """Return a copy on the device of an array of the processor."""
        with open_workspace(self._device, self._whole.traffic) as work:
            return work.upload(array)

    def download(self, array: DeviceArray) -> NDArray[Any]:
        """Return a copy of an array of the device."""
        with open_workspace(self._device, self._whole.traffic) as work:
            return work.download_new(array)


def find_plan(kernel: str, given: Any) -> Plan | None:
    """Return the plan for an input; None where the device lacks the kernel or the input is beyond its limits."""
    found = _KERNELS.get(kernel)
    return found.plan if found and found.is_within_limits(given) else None
