"""Sums over square windows about cells by summed-area tables: a window of any size costs four look-ups.

F. C. Crow, Summed-area tables for texture mapping, SIGGRAPH 1984, doi:10.1145/800031.808600.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.arrays import CellIndices
from beltscape.kernels.images.window_statistics import BAND_ROWS


def bands(cells: CellIndices, reach: int, rows: int) -> Iterator[tuple[NDArray[np.intp], slice]]:
    """Yield the indices of cells in one band of a field's ``rows``, and the rows up to ``reach`` about them."""
    if not len(cells[0]):
        return
    for first in range(int(cells[0].min()), int(cells[0].max()) + 1, BAND_ROWS):
        own = np.flatnonzero((cells[0] >= first) & (cells[0] < first + BAND_ROWS))
        if len(own):
            low, high = int(cells[0][own].min()), int(cells[0][own].max())
            yield own, slice(max(low - reach, 0), min(high + reach + 1, rows))


class WindowSums:
    """Summed-area tables of F fields. Whole numbers may overflow: sums of windows are exact nevertheless."""

    def __init__(self, fields: NDArray[np.int64] | NDArray[np.float64]) -> None:
        """Sum up ``fields`` (F, Ny, Nx), int64 or float64."""
        count, rows, columns = fields.shape
        self._shape = (rows, columns)
        table = np.zeros((count, rows + 1, columns + 1), fields.dtype)
        np.cumsum(fields, axis=2, out=table[:, 1:, 1:])
        for row in range(1, rows):
            table[:, row + 1, 1:] += table[:, row, 1:]
        self._table = table.reshape(count, -1)

    def at(self, cells: CellIndices, side: int) -> NDArray[Any]:
        """Return (F, H) sums over windows of odd ``side`` cells about H cells; nothing lies outside the fields."""
        rows, columns = self._shape
        half = side // 2
        top, bottom = np.maximum(cells[0] - half, 0), np.minimum(cells[0] + half + 1, rows)
        left, right = np.maximum(cells[1] - half, 0), np.minimum(cells[1] + half + 1, columns)
        table, stride = self._table, columns + 1
        lower, upper = bottom * stride, top * stride
        return (
            table[:, lower + right]
            - table[:, lower + left]
            - table[:, upper + right]
            + table[:, upper + left]
        )
