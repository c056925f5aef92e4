"""Sweep and aggregation over bands: the reference of `coarse`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.bands import bands
from beltscape.kernels.check import float32
from beltscape.kernels.reference.aggregation import aggregate
from beltscape.kernels.reference.sweep import sweep


def coarse(  # noqa: PLR0917 (its parts take the same in the same order)
    core: NDArray[np.float32],
    images: Sequence[NDArray[np.float32]],
    views: NDArray[np.float32],
    first: float,
    step: float,
    planes: int,
    floor: float,
    small_jump: int,
    large_jump: int,
    *,
    best: int = 2,
    threads: int = 0,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """See `beltscape.kernels.protocol.coarse`; ``threads`` is ignored here."""
    del threads
    core = float32("core", core, ("H", "W"))
    kept = []
    for band in bands(len(core)):
        rows = band.first, band.last
        cost = sweep(core, images, views, first, step, planes, floor, rows=rows, best=best)
        middle = slice(band.keep_first - band.first, band.keep_last - band.first)
        kept.append([part[middle] for part in aggregate(cost, small_jump, large_jump)])
    index, margin = (np.concatenate(part) for part in zip(*kept, strict=True))
    return index, margin
