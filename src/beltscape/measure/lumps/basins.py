"""Watershed of a field: catchment basins, and the crests between neighbouring basins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]


@dataclass(frozen=True, slots=True, eq=False)
class Borders:
    """Borders between neighbouring regions, first < second."""

    first: NDArray[np.int64]
    """(B,) region on one side."""
    second: NDArray[np.int64]
    """(B,) region on the other side."""
    sum: NDArray[np.float64]
    """(B,) the field summed along the border, at each pair of cells its higher value."""
    length: NDArray[np.int64]
    """(B,) number of pairs of neighbouring cells along the border."""


def find_basins(field: NDArray[np.float32], floor: float) -> NDArray[np.int64]:
    """Return basin numbers (R, C) from 0: each cell descends to its lowest neighbour until it reaches a minimum.

    Watershed by topographic distance, Meyer 1994, 10.1016/0165-1684(94)90060-4. Connected cells no higher than
    ``floor`` form one minimum.
    """
    rows, columns = field.shape
    index = np.arange(int(rows * columns)).reshape(rows, columns)
    around = np.pad(field, 1, constant_values=np.inf)
    lowest, to = field.copy(), index.copy()
    for down, right in _NEIGHBOURS:
        beside = around[1 + down : rows + 1 + down, 1 + right : columns + 1 + right]
        lower = beside < lowest
        lowest[lower] = beside[lower]
        to[lower] = index[lower] + (down * columns + right)
    pools, count = ndimage.label(field <= floor)
    first = np.full(count + 1, rows * columns, np.int64)
    np.minimum.at(first, pools.ravel(), index.ravel())
    to = np.where(pools > 0, first[pools], to).ravel()
    while True:
        further = to[to]
        if (further == to).all():
            return np.unique(to, return_inverse=True)[1].reshape(rows, columns)
        to = further


def find_borders(regions: NDArray[np.int64], field: NDArray[np.float32]) -> Borders:
    """Return the borders of regions (R, C) numbered from 0, between four-neighbours."""
    number = int(regions.max()) + 1
    keys: list[NDArray[np.int64]] = []
    heights: list[NDArray[np.float32]] = []
    for one, two in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        a, b = regions[one], regions[two]
        apart = a != b
        keys.append(np.minimum(a[apart], b[apart]) * number + np.maximum(a[apart], b[apart]))
        heights.append(np.maximum(field[one], field[two])[apart])
    key, which = np.unique(np.concatenate(keys), return_inverse=True)
    total = cast("NDArray[np.float64]", np.bincount(which, np.concatenate(heights), len(key)))
    return Borders(key // number, key % number, total, np.bincount(which, minlength=len(key)))
