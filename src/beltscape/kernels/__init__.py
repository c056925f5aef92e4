"""The inner loops: families of kernels with one signature each, and back ends that implement them.

A kernel's signature, documentation, checks and result stand in its family's module: `geometry`, `images`,
`sweep`, `least_squares`, `selection`, `networks`, `planes`, `photometry`, `statistics`, `holes`. It fills a record
of checked `arrays`, with packed projections of `projection`, and calls a back end (`backend`): `native` (C++, in
native/), `reference` (NumPy) or `cuda` (a GPU). `load` returns all families with one back end.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.backend import FrameNumbers, gpu_failures
from beltscape.kernels.cuda.device import GpuDevice
from beltscape.kernels.cuda.memory import DeviceError
from beltscape.kernels.geometry import (
    HeightRasterisationKernels,
    LayerFusionKernels,
    TriangulationKernels,
    VisibilityKernels,
)
from beltscape.kernels.holes import HoleFillingKernels
from beltscape.kernels.images import GatheringKernels, WarpingKernels
from beltscape.kernels.least_squares import LocalFitKernels, NormalEquationsKernels, ShiftFitKernels
from beltscape.kernels.networks import MessagePassingKernels, NetworkKernels
from beltscape.kernels.photometry import PhotometryKernels
from beltscape.kernels.planes import PixelKernels, PlaneKernels
from beltscape.kernels.selection import CandidateKernels, PropagationKernels
from beltscape.kernels.statistics import StatisticsKernels
from beltscape.kernels.sweep import PlaneSweepKernels

__all__ = [
    "FrameNumbers",
    "Kernels",
    "gpu_failures",
    "is_gpu_expected",
    "kernels_on_gpu",
    "load",
    "load_on_processor",
]

Result = TypeVar("Result")
Kept = TypeVar("Kept", bound=NDArray[Any])


class Kernels(
    TriangulationKernels,
    WarpingKernels,
    VisibilityKernels,
    PlaneSweepKernels,
    NormalEquationsKernels,
    LocalFitKernels,
    ShiftFitKernels,
    PropagationKernels,
    NetworkKernels,
    MessagePassingKernels,
    CandidateKernels,
    GatheringKernels,
    HeightRasterisationKernels,
    LayerFusionKernels,
    HoleFillingKernels,
    PlaneKernels,
    PixelKernels,
    StatisticsKernels,
    PhotometryKernels,
):
    """All kernels of one back end; stages receive them as a value.

    Every kernel takes ``threads`` (0 takes all cores), on which its result does not depend, and raises
    KernelError where the shapes of its arrays do not fit each other.
    """

    @property
    def failure(self) -> str | None:
        """Why the GPU is no longer used; None where it is, and where there is none."""
        return getattr(self.backend, "failure", None)

    def run_resident(self, job: Callable[[Kernels], Result]) -> Result:
        """Return a job's result with kernels whose results stay on the GPU; where it fails, all once more without it.

        Without a GPU the job has these kernels. It must return arrays of the processor.
        """
        resident = getattr(self.backend, "resident", None)
        if resident is not None and self.failure is None:
            try:
                return job(Kernels(resident))
            except DeviceError as error:
                resident.give_up(error)
        return job(self)

    @property
    def is_resident(self) -> bool:
        """Whether results stay on a GPU."""
        return hasattr(self.backend, "keep")

    def keep(self, array: Kept) -> Kept:
        """Return an array for several kernels: itself, or one that is copied to the GPU once and is read-only."""
        keep: Callable[[Kept], Kept] | None = getattr(self.backend, "keep", None)
        return keep(array) if keep else array

    def replay(self, function: Callable[..., Result], *given: Any) -> Result:
        """Return ``function(*given)``; a GPU records its launches at the first call and then runs them as one graph.

        ``function`` stands in a module and depends on its arguments alone, and so do its launches: on their shapes,
        and on what is no array. Of numbers, only those of `beltscape.kernels.backend.FrameNumbers` may differ from
        frame to frame. Whatever the processor needs to know of a result is read outside.
        """
        replay: Callable[..., Result] | None = getattr(self.backend, "replay", None)
        return replay(function, given) if replay else function(*given)

    def choose_pixels(self, on_processor: int) -> int:
        """Return how many pixels a call should take together, for a number that suits a processor's caches."""
        return int(getattr(self.backend, "pixels_at_once", on_processor))


@cache
def load(name: str | None = None) -> Kernels:
    """Return kernels by name: ``reference``, ``native`` (this processor's best), ``v2``, ``v3``, ``v4``, ``cuda``.

    ``emulated`` runs those of ``cuda`` on the processor, for tests. Without a name the environment variable
    BELTSCAPE_KERNELS decides; without it, ``cuda`` is taken where the extra ``gpu`` is installed, a GPU is there and
    its self-test agrees with the processor, else ``native``.
    """
    name = name or os.environ.get("BELTSCAPE_KERNELS")
    if name == "reference":
        from beltscape.kernels.reference import ReferenceBackend

        return Kernels(ReferenceBackend())
    from beltscape.kernels.native import NativeBackend, levels

    if name is None or name == "native":
        native = Kernels(NativeBackend(levels()[-1]))
        return native if name else _find_gpu_kernels(native) or native
    if name in levels():
        return Kernels(NativeBackend(name))
    if name == "cuda":
        from beltscape.kernels.cuda.cuda_device import CudaDevice

        return _kernels_on(CudaDevice())
    if name.startswith("emulated"):
        from beltscape.kernels.cuda.emulated_device import EmulatedDevice

        return _kernels_on(EmulatedDevice(int(name.partition("-")[2] or 0)))
    raise KernelError(
        f"no kernels named {name!r} on this processor; there are reference, native, {', '.join(levels())}, cuda"
    )


def load_on_processor() -> Kernels:
    """Return the processor's kernels, for all but matching; a GPU is not opened, which takes time and its memory.

    The environment variable BELTSCAPE_KERNELS chooses among them.
    """
    name = os.environ.get("BELTSCAPE_KERNELS", "native")
    return load("native" if name == "cuda" or name.startswith("emulated") else name)


def is_gpu_expected() -> bool:
    """Return whether `load` would look for a GPU: its driver and the extra ``gpu`` are there. Opens none."""
    from beltscape.kernels.cuda.cuda_device import is_driver_present, is_library_present

    name = os.environ.get("BELTSCAPE_KERNELS") or "cuda"
    return name == "cuda" and is_driver_present() and is_library_present()


def kernels_on_gpu() -> tuple[str, ...]:
    """Return the names of the kernels that ``cuda`` computes on the GPU; the others run on the processor."""
    from beltscape.kernels.cuda.backend import KERNELS

    return KERNELS


def _kernels_on(device: GpuDevice) -> Kernels:
    """Return the CUDA back end's kernels on a device, with this processor's best level for what it lacks."""
    from beltscape.kernels.cuda.backend import CudaBackend
    from beltscape.kernels.native import NativeBackend, levels

    return Kernels(CudaBackend(device, NativeBackend(levels()[-1])))


def _find_gpu_kernels(native: Kernels) -> Kernels | None:
    """Return a GPU's kernels; None without a GPU, and with a warning where it does not agree with the processor."""
    from beltscape.kernels.cuda.cuda_device import CudaDevice, is_driver_present, is_library_present

    if not (is_driver_present() and is_library_present()):
        return None
    from beltscape.kernels.self_test import find_disagreement

    try:
        found = _kernels_on(CudaDevice())
        problem = find_disagreement(found, native)
        if problem is None:
            return found
    except KernelError as error:
        problem = str(error)
    warnings.warn(f"the GPU is not used, the processor is: {problem}", RuntimeWarning, stacklevel=3)
    return None
