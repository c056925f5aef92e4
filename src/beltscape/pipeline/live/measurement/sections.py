"""A buffer of finished belt rows, from which the mean cross-section of each strip is taken."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt.ledger_entries import CrossSection
from beltscape.measure.flow.fusion.empty_belt_reference import EmptyBeltReference
from beltscape.measure.flow.fusion.rows import BeltPiece

_CELL_MM = 5.0
"""Approximate column width of a stored cross-section."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    s_mm: NDArray[np.float64]
    height_mm: NDArray[np.float32]


class SectionBuffer:
    """Keeps the belt rows that unfinished strips may still need."""

    def __init__(self, reference: EmptyBeltReference) -> None:
        """Prepare for the columns of the empty-belt reference, joined to about 5 mm."""
        self._cell_mm = reference.cell_mm
        self._side = max(1, round(_CELL_MM / reference.cell_mm))
        self._columns = reference.grid.shape[1] // self._side * self._side
        x = reference.grid.x_mm[: self._columns]
        self.x_mm = x.reshape(-1, self._side).mean(axis=1).astype(np.float32)
        self._parts: deque[_Rows] = deque()

    def add(self, piece: BeltPiece) -> NDArray[np.float32]:
        """Add a finished piece; return its heights, (n, Nx) float32 mm, on the joined columns."""
        height = piece.height_mm[:, : self._columns]
        joined = height.reshape(len(height), -1, self._side).mean(axis=2).astype(np.float32)
        s = self._cell_mm * (piece.first + np.arange(len(joined), dtype=np.float64))
        self._parts.append(_Rows(s, joined))
        return joined

    def mean_section(self, strip_mm: tuple[float, float]) -> CrossSection | None:
        """Return the mean section of a strip (of its row if it has no length); earlier rows are removed."""
        low, high = strip_mm
        half = self._cell_mm / 2
        while self._parts and self._parts[0].s_mm[-1] + half < low:
            self._parts.popleft()
        near = [rows.height_mm[_within(rows.s_mm, low - half, high + half)] for rows in self._parts]
        rows = np.concatenate(near) if near else np.empty((0, len(self.x_mm)), np.float32)
        return (
            CrossSection(self.x_mm, rows.mean(axis=0, dtype=np.float64).astype(np.float32))
            if len(rows)
            else None
        )


def _within(s_mm: NDArray[np.float64], low_mm: float, high_mm: float) -> slice:
    first, last = np.searchsorted(s_mm, [low_mm, high_mm])
    return slice(int(first), int(last))
