"""The CUDA back end: plans of launches for the kernels that it has, and the native back end for all others."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import NDArray

from beltscape.kernels.backend import Backend
from beltscape.kernels.cuda import least_squares, networks, sweep
from beltscape.kernels.cuda.device import DeviceError, GpuDevice, Workspace

Plan = Callable[[Workspace, Any, Sequence[NDArray[Any]]], None]
"""Uploads a record, launches kernels and downloads the results."""


def _has_no_limit(_: Any) -> bool:
    return True


_PLANS: dict[str, tuple[Plan, Callable[[Any], bool]]] = {
    "sweep": (sweep.sweep, sweep.can_sweep),
    "aggregate": (sweep.aggregate, _has_no_limit),
    "sweep_and_aggregate": (sweep.sweep_and_aggregate, sweep.can_sweep),
    "warp": (least_squares.warp, _has_no_limit),
    "normal_equations": (least_squares.normal_equations, least_squares.can_sum_equations),
    "local_fit": (least_squares.local_fit, _has_no_limit),
    "evaluate_network": (networks.evaluate_network, networks.can_evaluate),
    "pass_messages": (networks.pass_messages, networks.can_evaluate),
}
"""Kernel → its plan, and whether an input is within its limits."""

KERNELS = tuple(_PLANS)
"""What the device computes; other kernels run on the CPU."""


class CudaBackend:
    """Kernels on a device; the native back end takes what the device lacks, and everything once it has failed."""

    def __init__(self, device: GpuDevice, native: Backend) -> None:
        self.name = device.name
        self.failure: str | None = None
        """Why the device is no longer used."""
        self._device = device
        self._native = native

    def run(
        self, kernel: str, given: Sequence[Any], out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """See `beltscape.kernels.backend.Backend`."""
        plan, is_within_limits = _PLANS.get(kernel, (None, None))
        if plan and is_within_limits and is_within_limits(given) and self.failure is None:
            try:
                with self._device.workspace() as work:
                    plan(work, given, out)
                return out
            except DeviceError as error:
                self.failure = str(error)
                warnings.warn(
                    f"the GPU is no longer used, the processor takes over: {error}",
                    RuntimeWarning,
                    stacklevel=2,
                )
        return self._native.run(kernel, given, out, threads)
