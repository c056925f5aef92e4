"""Normalised correlations of many patches with the areas around them, and their peaks.

All functions work on N patches at a time: a call of NumPy or OpenCV for a single patch takes longer than its pixels.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array

Maps = NDArray[np.float32]
"""(N, R, C): correlations of N patches at the rows and columns that were searched."""
_PEAK_PX = 3
"""A correlation farther from the peak than this belongs to another position."""
_LEAST_LEAD = 0.08
"""Least difference of the peak's correlation from that of any other position."""
_LEAST_SQUARE = 1e-3
"""Least sum of squares of a patch that is divided by: a patch without texture has no correlation."""


def correlate_closely(areas: NDArray[np.float32], patches: NDArray[np.float32]) -> Maps:
    """Return the correlations (N, K + 1, K + 1) of patches (N, S, S) within areas (N, S + K, S + K), of a small K.

    It takes a pass over all areas for each of the (K + 1)² positions. Errors are below 0.00001 for levels of 8 bits.
    """
    side = patches.shape[1]
    positions = range(areas.shape[1] - side + 1)
    # sums of squares of deviations from a mean that is about theirs keep their digits in float32
    areas = areas - areas.mean(axis=(1, 2), keepdims=True)
    patches = patches - patches.mean(axis=(1, 2), keepdims=True)
    square = np.einsum("nij,nij->n", patches, patches)
    maps = np.empty((len(patches), len(positions), len(positions)), np.float32)
    for row in positions:
        for column in positions:
            part = np.ascontiguousarray(areas[:, row : row + side, column : column + side])
            spread = np.einsum("nij,nij->n", part, part) - part.sum(axis=(1, 2)) ** 2 / side**2
            both = np.einsum("nij,nij->n", part, patches)
            maps[:, row, column] = both / np.sqrt(np.maximum(square * spread, _LEAST_SQUARE**2))
    return maps


def correlate_widely(pairs: Iterable[tuple[NDArray[np.generic], NDArray[np.generic]]]) -> Maps:
    """Return the correlations of patches within areas, given as pairs of an area and its patch of one size each."""
    return np.array([cv2.matchTemplate(area, patch, cv2.TM_CCOEFF_NORMED) for area, patch in pairs])


def find_peaks(maps: Maps, least: float) -> Array:
    """Return (N, 2) column and row of the greatest correlation; NaN where it is weak, ambiguous or at the border."""
    if not maps.size:
        return np.full((len(maps), 2), np.nan)
    number, (rows, columns) = np.arange(len(maps)), maps.shape[1:]
    row, column = np.divmod(maps.reshape(len(maps), -1).argmax(axis=1), columns)
    best = maps[number, row, column]
    is_clear = (best >= least) & (row > 0) & (row < rows - 1) & (column > 0) & (column < columns - 1)
    if rows * columns > (2 * _PEAK_PX + 1) ** 2:
        near_row = np.abs(np.arange(rows) - row[:, None]) <= _PEAK_PX
        near_column = np.abs(np.arange(columns) - column[:, None]) <= _PEAK_PX
        others = np.where(near_row[:, :, None] & near_column[:, None, :], np.float32(-1), maps)
        is_clear &= others.max(axis=(1, 2)) <= best.astype(np.float64) - _LEAST_LEAD
    peaks = np.full((len(maps), 2), np.nan)
    found = np.flatnonzero(is_clear)
    at, row, column = best[found], row[found], column[found]
    along_u = find_vertices(maps[found, row, column - 1], at, maps[found, row, column + 1])
    along_v = find_vertices(maps[found, row - 1, column], at, maps[found, row + 1, column])
    peaks[found] = np.column_stack([column + along_u, row + along_v])
    return peaks


def find_vertices(
    before: NDArray[np.float32], at: NDArray[np.float32], after: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Return the offsets (N,) of the vertices of parabolas through three neighbours each, within ±0.5."""
    low, middle, high = (values.astype(np.float64) for values in (before, at, after))
    bend = low - 2 * middle + high
    is_peak = bend < 0
    return np.where(is_peak, np.clip(0.5 * (low - high) / np.where(is_peak, bend, -1.0), -0.5, 0.5), 0.0)
