"""The inner loops: families of kernels with one signature each, and back ends that implement them.

A kernel's signature, documentation, checks and result stand in its family's module: `geometry`, `images`,
`sweep`, `least_squares`, `selection`, `networks`, `holes`. It fills a record of checked `arrays`, with packed
projections of `projection`, and calls a back end (`backend`): `native` (C++, in native/) or `reference`
(NumPy). `load` returns all families with one back end.
"""

from __future__ import annotations

import os
from functools import cache

from beltscape.core.errors import KernelError
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
from beltscape.kernels.selection import CandidateKernels, PropagationKernels
from beltscape.kernels.sweep import PlaneSweepKernels

__all__ = ["Kernels", "load"]


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
):
    """All kernels of one back end; stages receive them as a value.

    Every kernel takes ``threads`` (0 takes all cores), on which its result does not depend, and raises
    KernelError where the shapes of its arrays do not fit each other.
    """


@cache
def load(name: str | None = None) -> Kernels:
    """Return kernels by name: ``native`` (the best level of this processor), ``v2``, ``v3``, ``v4``, ``reference``.

    Without a name the environment variable BELTSCAPE_KERNELS decides, then ``native`` is taken.
    """
    name = name or os.environ.get("BELTSCAPE_KERNELS") or "native"
    if name == "reference":
        from beltscape.kernels.reference import ReferenceBackend

        return Kernels(ReferenceBackend())
    from beltscape.kernels.native import NativeBackend, levels

    if name == "native":
        return Kernels(NativeBackend(levels()[-1]))
    if name in levels():
        return Kernels(NativeBackend(name))
    raise KernelError(
        f"no kernels named {name!r} on this processor; there are reference, native, {', '.join(levels())}"
    )
