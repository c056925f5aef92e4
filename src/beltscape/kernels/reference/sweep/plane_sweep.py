"""Dissimilarity of auxiliaries and core, plane by plane: the reference of `sweep` and `sweep_and_aggregate`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    kept = []
    for band in bands(len(given.core)):
        (cost,) = sweep(SweepInput(*given[:8], band.first), band.last - band.first)
        middle = slice(band.keep_first - band.first, band.keep_last - band.first)
        parts = aggregate(AggregateInput(cost, given.small_jump, given.large_jump))
        kept.append([part[middle] for part in parts])
    index, margin = (np.concatenate(part) for part in zip(*kept, strict=True))
    return index, margin


def _plane(given: SweepInput, s: float) -> NDArray[np.uint8]:
    """Costs (H, W) of one plane."""
    height, width = given.core.shape
    v, u = np.mgrid[:height, :width].astype(np.float64)
    core = _centred_windows(given.core.astype(np.float64))
    each = []
    for image, view in zip(given.images, given.views, strict=True):
        seen_u, seen_v, _ = project(view, u, v, np.full(u.shape, s))
        aux = _centred_windows(_bilinear(image.astype(np.float64), seen_u, seen_v))
        energy = (core**2).sum(axis=0) + (aux**2).sum(axis=0) + 18 * given.floor
        c = ((core - aux) ** 2).sum(axis=0) / energy
        each.append(np.where(np.isnan(c), 1, np.minimum(c, 1)))
    mean = np.sort(each, axis=0)[: given.best].mean(axis=0)
    return np.floor(WORST * mean + 0.5).astype(np.uint8)


def _centred_windows(image: Array) -> Array:
    """(9, H, W): the 3 × 3 neighbours of every pixel without their mean, the border repeated."""
    height, width = image.shape
    padded = np.pad(image, 1, mode="edge")
    windows = np.stack([padded[y : y + height, x : x + width] for y in range(3) for x in range(3)])
    return windows - windows.mean(axis=0)


def _bilinear(image: Array, u: Array, v: Array) -> Array:
    """The image (h, w) at (u, v); NaN where the 2 × 2 footprint is not inside."""
    height, width = image.shape
    with np.errstate(invalid="ignore"):
        inside = (u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    x, y = u.astype(int), v.astype(int)
    u, v = u - x, v - y
    above = (1 - u) * image[y, x] + u * image[y, x + 1]
    below = (1 - u) * image[y + 1, x] + u * image[y + 1, x + 1]
    return np.where(inside, (1 - v) * above + v * below, np.nan)
