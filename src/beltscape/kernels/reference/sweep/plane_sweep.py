"""Dissimilarity of auxiliaries and core, plane by plane: the reference of `sweep` and `sweep_and_aggregate`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.reference.sampling import bilinear, centred_windows, window_dissimilarity
from beltscape.kernels.reference.sweep.aggregation import aggregate
from beltscape.kernels.reference.view import project
from beltscape.kernels.sweep.bands import bands
from beltscape.kernels.sweep.plane_sweep import WORST, AggregateInput, SweepAndAggregateInput, SweepInput

Array = NDArray[np.float64]


def sweep(given: SweepInput, rows: int) -> tuple[NDArray[np.uint8]]:
    """Return the costs (rows, W, planes)."""
    cost = np.stack([_plane(given, given.first + given.step * d) for d in range(given.planes)], axis=-1)
    return (cost[given.first_row : given.first_row + rows],)


def sweep_and_aggregate(given: SweepAndAggregateInput) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return plane and margin (H, W) each."""
    kept: list[list[NDArray[np.float32]]] = []
    for band in bands(len(given.core)):
        (cost,) = sweep(SweepInput(*given[:8], band.first), band.last - band.first)
        middle = slice(band.keep_first - band.first, band.keep_last - band.first)
        parts = aggregate(AggregateInput(cost, given.small_jump, given.large_jump))
        kept.append([part[middle] for part in parts])
    index, margin = (np.concatenate(part) for part in zip(*kept, strict=True))
    return index, margin


def _plane(given: SweepInput, s: float) -> NDArray[np.uint8]:
    """Return the costs (H, W) of one plane."""
    height, width = given.core.shape
    v, u = np.mgrid[:height, :width].astype(np.float64)
    core = centred_windows(given.core.astype(np.float64))
    each: list[NDArray[np.float64]] = []
    for image, view in zip(given.images, given.views, strict=True):
        seen_u, seen_v, _ = project(view, u, v, np.full((height, width), s))
        aux = centred_windows(bilinear(image.astype(np.float64), seen_u, seen_v))
        each.append(window_dissimilarity(core, aux, given.floor))
    mean = np.sort(each, axis=0)[: given.best].mean(axis=0)
    return np.floor(WORST * mean + 0.5).astype(np.uint8)
