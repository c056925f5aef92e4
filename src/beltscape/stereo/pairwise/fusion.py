"""Fusion of the depths of several pairs: the arithmetic mean over the pairs that agree (the paper's Eq. 24)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_STRIP_ROWS = 64
"""Rows that are fused at a time, so that they stay in the cache."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedDepth:
    """The mean over the pairs, and their scatter."""

    depth_mm: NDArray[np.float32]
    """(H, W) float32, NaN where no pair measured or no two pairs agree."""
    views: NDArray[np.uint8]
    """(H, W) uint8: number of pairs in the mean."""
    scatter_mm2: NDArray[np.float32]
    """(H, W) float32: sum of their squared deviations from the mean."""


def fuse_depths(depths_mm: NDArray[np.float32], agreement: float | None) -> FusedDepth:
    """Return the mean over the pairs that agree.

    Parameters
    ----------
    depths_mm
        (n, H, W) float32, NaN where a pair did not measure.
    agreement
        Largest difference of agreeing depths, divided by Z²: a difference of inverse depth, 1/mm. The largest
        agreeing group is averaged, among equals the closest. Where no two of several pairs agree, the depth is
        NaN. With None all pairs are averaged, as in Eq. 24.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, Eq. 24.
    """
    count, height, width = depths_mm.shape
    depth = np.empty((height, width), np.float32)
    views = np.empty((height, width), np.uint8)
    scatter = np.empty((height, width), np.float32)
    for top in range(0, height, _STRIP_ROWS):
        rows = slice(top, top + _STRIP_ROWS)
        strip = np.sort(depths_mm[:, rows].astype(np.float64), axis=0)  # NaN is last
        keep = (
            np.isfinite(strip) if agreement is None or count == 1 else _mask_largest_group(strip, agreement)
        )
        number = keep.sum(axis=0)
        values = np.where(keep, strip, 0.0)
        with np.errstate(invalid="ignore"):
            mean = values.sum(axis=0) / number
        depth[rows], views[rows] = mean, number
        scatter[rows] = np.where(keep, (strip - mean) ** 2, 0.0).sum(axis=0)
    return FusedDepth(depth, views, scatter)


def _mask_largest_group(ordered: NDArray[np.float64], agreement: float) -> NDArray[np.bool_]:
    """Return (n, H, W) bool: the largest agreeing group of values sorted along axis 0."""
    count = len(ordered)
    best_votes = np.zeros(ordered.shape[1:], np.int64)
    best_width = np.full(ordered.shape[1:], np.inf)
    first = np.zeros(ordered.shape[1:], np.int64)
    for i in range(count):
        limit = ordered[i] + agreement * ordered[i] ** 2
        inside = ordered[i:] <= limit
        votes = inside.sum(axis=0)
        width = np.where(inside, ordered[i:] - ordered[i], 0.0).max(axis=0)
        better = (votes > best_votes) | ((votes == best_votes) & (votes > 1) & (width < best_width))
        best_votes, best_width = np.where(better, votes, best_votes), np.where(better, width, best_width)
        first = np.where(better, i, first)
    measured = np.isfinite(ordered).sum(axis=0)
    accepted = (best_votes > 1) | (measured == 1)
    index = np.arange(count)[:, None, None]
    return accepted & (index >= first) & (index < first + best_votes)
