"""The fused belt from end to end at a reduced resolution, for reports."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt.height_map import HeightMap
from beltscape.measure.flow.fusion.empty_belt_reference import EmptyBeltReference
from beltscape.measure.flow.fusion.rows import BeltPiece

_CELL_MM = 4.0
"""Cell of the picture."""
_LONGEST_ROWS = 50_000
"""Rows kept for the picture, 200 m of belt; older ones are dropped, which bounds the memory."""


class BeltPicture:
    """Collects finished pieces of belt as means over blocks of cells; very long belts lose their oldest part."""

    def __init__(self, ground: EmptyBeltReference) -> None:
        """Use the cells of an empty-belt reference."""
        self._cell_mm = ground.cell_mm
        self._x_mm = ground.grid.origin_mm[0]
        self._side = max(1, round(_CELL_MM / ground.cell_mm))
        self._parts: dict[int, NDArray[np.float64]] = {}
        """For each row of blocks: (3, m) sums of height and of measured cells, and the number of rows."""

    @property
    def cell_mm(self) -> float:
        """Return the edge of a block."""
        return self._side * self._cell_mm

    def add(self, piece: BeltPiece) -> None:
        """Add a finished piece."""
        columns = piece.height_mm.shape[1] // self._side * self._side
        rows = piece.first + np.arange(len(piece.height_mm))
        for block in np.unique(rows // self._side):
            own = rows // self._side == block
            values = np.stack([piece.height_mm[own, :columns], piece.measured[own, :columns]]).astype(
                np.float64
            )
            sums = values.sum(axis=1).reshape(2, -1, self._side).mean(axis=2)
            sums = np.vstack([sums, np.full(sums.shape[1], own.sum())])
            self._parts[int(block)] = self._parts.get(int(block), 0.0) + sums
        while len(self._parts) > _LONGEST_ROWS:
            del self._parts[next(iter(self._parts))]

    def height_map(self) -> tuple[HeightMap, NDArray[np.float64]]:
        """Return heights over the empty belt on x and s, NaN outside all views, and the share of measured cells."""
        if not self._parts:
            empty = np.full((1, 1), np.nan)
            return HeightMap(empty, empty, (self._x_mm, 0.0), self.cell_mm), np.zeros((1, 1))
        first, last = min(self._parts), max(self._parts)
        columns = next(iter(self._parts.values())).shape[1]
        sums = np.full((3, last - first + 1, columns), np.nan)
        for block, part in self._parts.items():
            sums[:, block - first] = part
        middle = 0.5 * (self._side - 1) * self._cell_mm
        origin = (self._x_mm + middle, first * self.cell_mm + middle)
        height = sums[0] / sums[2]
        return HeightMap(height, np.full_like(height, np.nan), origin, self.cell_mm), np.nan_to_num(
            sums[1] / sums[2]
        )
