"""The belt's edges: by how much each row's edge recedes from its usual place, by all frames that saw the row."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

_LEAST_CELLS = 2
"""Cells by which an edge must recede to count as torn: rounding alone moves it by one."""
_END_CELLS, _LEAST_BARE_END = 3, 2
"""Measured cells examined at an end of a row, and how many of them must be bare: else material may hide the edge."""
_LOWEST_MM = -50.0
"""What lies deeper under the belt as it lies is not the belt, but what shows beside it or through a notch."""
_MEMORY = 0.98
"""Memory of an edge's usual place, per row of belt that has passed: of 50 rows, one and a half widths of the belt."""
_AGREEING = 0.25
"""Quantile of the frames' recessions that counts: nearly all frames that show a row must agree, of four all."""


_LEAST_FRAMES = 2
"""Frames that must show a row's edge where it was in view so often: one alone may miss cells by chance."""


@dataclass(frozen=True, slots=True)
class EdgeRow:
    """One edge in one row of the belt, assessed."""

    number: int
    """Of the row."""
    size_mm: float
    """By how much the edge recedes; NaN: it was hidden."""
    is_empty: bool
    """Whether no load lay beside it."""


@dataclass(slots=True)
class _Waiting:
    """A row that is not assessed yet."""

    cells: list[float]
    """Recessions in the frames so far; NaN: hidden."""
    is_empty: bool


@dataclass(slots=True)
class EdgeHistory:
    """Follows one edge, at the first column of the rows it receives.

    An edge recedes that lies farther in than is usual at its place in the view, in every frame that shows its row.
    What stays at its place in the view is no mark of the belt: where few pixels meet the edge its last cells are
    missing in some rows of the view, frame after frame, and elsewhere by chance. A tear moves with the belt.
    """

    side_mm: float
    """Edge of a cell."""
    _usual: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    """(n,) number of cells missing before the belt in each row of the view; NaN: not seen yet."""
    _waiting: dict[int, _Waiting] = field(default_factory=dict[int, _Waiting])
    """Rows in view that are not assessed yet, by their numbers."""

    def add(
        self,
        numbers: NDArray[np.int64],
        over_mm: NDArray[np.float64],
        bare: NDArray[np.bool_],
        new: NDArray[np.bool_],
        is_empty: NDArray[np.bool_],
    ) -> list[EdgeRow]:
        """Return the rows that have left the view, in the order of their numbers.

        ``numbers`` (n,) are those of its rows, with heights and bare cells (n, m); ``new`` are rows that count from
        now on.
        """
        receding = self._measure(over_mm, bare, int(new.sum()))
        by_number = dict(zip(numbers.tolist(), receding.tolist(), strict=True))
        for number, one in self._waiting.items():
            if number in by_number:
                one.cells.append(by_number[number])
        for number, empty in zip(numbers[new].tolist(), is_empty[new].tolist(), strict=True):
            self._waiting[number] = _Waiting([by_number[number]], empty)
        left = sorted(number for number in self._waiting if number < int(numbers.min()))
        return [self._assess(number, self._waiting.pop(number)) for number in left]

    def _assess(self, number: int, one: _Waiting) -> EdgeRow:
        known = sorted(cells for cells in one.cells if not np.isnan(cells))
        is_known = len(known) >= min(len(one.cells), _LEAST_FRAMES)
        size = known[int(_AGREEING * (len(known) - 1))] * self.side_mm if is_known else np.nan
        return EdgeRow(number, size, one.is_empty)

    def forget(self) -> None:
        """Take the edge's next place as the usual one: the belt has run off to a side."""
        self._usual = np.empty(0)

    def clear(self) -> None:
        """Drop the rows that are not assessed yet: rows between them and the next were not seen."""
        self._waiting.clear()

    def _measure(
        self, over_mm: NDArray[np.float64], bare: NDArray[np.bool_], passed: int
    ) -> NDArray[np.float64]:
        """Return by how many cells the edge recedes in rows (n, m) of the view, (n,); NaN where it is hidden.

        ``passed`` is the number of rows of belt since the last frame.
        """
        cells = np.array([_count_missing(*row) for row in zip(over_mm, bare, strict=True)])
        if len(self._usual) != len(cells):
            self._usual = cells.copy()
        # an edge cannot reach beyond itself
        is_new = np.isnan(self._usual) | (cells <= self._usual - _LEAST_CELLS)
        self._usual = np.where(is_new, cells, self._usual)
        by = cells - self._usual
        recedes = np.nan_to_num(by) >= _LEAST_CELLS
        self._usual = self._usual + (1 - _MEMORY**passed) * np.where(recedes, 0.0, np.nan_to_num(by))
        # where the view never shows the edge it shows no tear either
        is_blind = (
            self._usual > np.nanmedian(self._usual) + _LEAST_CELLS / 2
            if np.isfinite(self._usual).any()
            else False
        )
        return np.where(recedes, by, np.where(np.isnan(by) | is_blind, np.nan, 0.0))


def _count_missing(over_mm: NDArray[np.float64], bare: NDArray[np.bool_]) -> float:
    """Return the number of cells of a row (m,) that are missing before the belt; NaN unless it is bare there."""
    on = np.flatnonzero(over_mm > _LOWEST_MM)[:_END_CELLS]
    return float(on[0]) if len(on) and bare[on].sum() >= _LEAST_BARE_END else np.nan
