"""Semi-global aggregation over eight paths: the reference of `aggregate`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.sweep.plane_sweep import WORST, AggregateInput

Array = NDArray[np.float64]
PATHS = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]
"""Steps (dy, dx) along the eight paths."""


def aggregate(given: AggregateInput) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return plane and margin (rows, W) each."""
    cost, small_jump, large_jump = given
    cost_of_plane = np.minimum(cost, WORST).astype(np.float64)
    sums = np.sum([_path(cost_of_plane, dy, dx, small_jump, large_jump) for dy, dx in PATHS], axis=0)
    return _decide(sums)


def _path(cost: Array, dy: int, dx: int, small_jump: int, large_jump: int) -> Array:
    """Return the costs (rows, W, D) along paths that come from (y + dy, x + dx)."""
    rows, width, _ = cost.shape
    path = cost.copy()
    for y in range(rows) if dy <= 0 else range(rows - 1, -1, -1):
        for x in range(width) if dx <= 0 else range(width - 1, -1, -1):
            if not (0 <= y + dy < rows and 0 <= x + dx < width):
                continue
            before = path[y + dy, x + dx]
            padded = np.pad(before, 1, constant_values=np.inf)
            neighbour = np.minimum(padded[:-2], padded[2:]) + small_jump
            least = before.min()
            path[y, x] += np.minimum(np.minimum(before, neighbour), least + large_jump) - least
    return path


def _decide(sums: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return planes and margins (rows, W) from sums (rows, W, D)."""
    planes = np.arange(int(sums.shape[2]))
    best = sums.argmin(axis=2)
    at = best[..., None]
    least = np.take_along_axis(sums, at, axis=2)
    other = np.where(abs(planes - at) > 1, sums, np.inf).min(axis=2)
    left = np.take_along_axis(sums, np.maximum(at - 1, 0), axis=2)
    right = np.take_along_axis(sums, np.minimum(at + 1, planes[-1]), axis=2)
    rise = np.maximum(left, right) - least
    inner = (at > 0) & (at < planes[-1]) & (rise > 0)
    part = np.where(inner, 0.5 * (left - right) / np.where(rise > 0, rise, 1), 0)[..., 0]
    return (best + part).astype(np.float32), ((other - least[..., 0]) / (len(PATHS) * WORST)).astype(
        np.float32
    )
