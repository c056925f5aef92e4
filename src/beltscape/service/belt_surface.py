"""The surface of the last metres of belt in coarse cells, encoded for the page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.events import BeltStretch

STEP_MM = 1 / 16
"""Height of one count: 32,767 counts are two metres, and a step is below one pixel of colour."""
OFFSET_MM = -100.0
"""Height of count 0; noise below the empty belt must not wrap."""
FILLED = 0x8000
"""Bit of cells that no frame measured; their height is interpolated."""
UNKNOWN = 0xFFFF
"""Count of cells without a height."""
_MOST_COLUMNS = 256
"""Columns of the picture of the belt; a screen shows no more."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltRows:
    """Consecutive rows of cells across the belt."""

    epoch: int
    """Increases when the belt coordinate starts anew; rows of another epoch do not belong to this surface."""
    first: int
    """Number of the first row; it is centred at belt coordinate (first + 0.5) cell_mm."""
    cell_mm: float
    """Length of a row."""
    x_mm: NDArray[np.float32]
    """(Nx,) float32 centres of the cells across the belt."""
    counts: NDArray[np.uint16]
    """(n, Nx) uint16 heights as ``encode_heights`` returns them."""


def encode_heights(height_mm: NDArray[np.floating], measured: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Return heights over the empty belt as uint16 counts; NaN becomes UNKNOWN."""
    known = np.isfinite(height_mm)
    counts = np.clip(np.rint((np.where(known, height_mm, 0) - OFFSET_MM) / STEP_MM), 0, FILLED - 2)
    coded = counts.astype(np.uint16) | np.where(measured, 0, FILLED).astype(np.uint16)
    return np.where(known, coded, UNKNOWN).astype(np.uint16)


def decode_heights(counts: NDArray[np.uint16]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return heights in mm, float32, NaN where unknown, and the mask of measured cells."""
    height = (counts & (FILLED - 1)).astype(np.float32) * STEP_MM + OFFSET_MM
    return np.where(counts == UNKNOWN, np.float32(np.nan), height), counts < FILLED


class SurfaceWindow:
    """A ring buffer of rows: takes finished stretches, drops the oldest rows. Not thread-safe."""

    def __init__(self, length_m: float, cell_mm: float) -> None:
        self._min_cell_mm = cell_mm
        self._length_mm = length_m * 1000
        self._epoch = 0
        self._restart(None)

    def _restart(self, stretch: BeltStretch | None) -> None:
        """Start a new epoch on the grid of ``stretch``."""
        self._source_x = None if stretch is None else stretch.x_mm
        self._epoch += stretch is not None
        self._begin: int | None = None
        self._end: int | None = None
        self._open = _OpenRow.make_empty()
        if stretch is None:
            return
        spacing = float(np.median(np.diff(stretch.x_mm))) if stretch.x_mm.size > 1 else self._min_cell_mm
        across = max(self._min_cell_mm, spacing, float(np.ptp(stretch.x_mm)) / _MOST_COLUMNS)
        column = np.floor((stretch.x_mm - stretch.x_mm[0]) / across).astype(int)
        self._first_of_column = np.flatnonzero(np.diff(column, prepend=-1))
        self._x_mm = np.add.reduceat(stretch.x_mm, self._first_of_column) / self._count_per_column()
        self._cell_mm = max(self._min_cell_mm, stretch.cell_mm)
        rows = max(int(self._length_mm / self._cell_mm), 1)
        self._ring = np.full((rows, self._x_mm.size), UNKNOWN, np.uint16)

    def _count_per_column(self) -> NDArray[np.intp]:
        assert self._source_x is not None
        return np.diff(self._first_of_column, append=self._source_x.size)

    def add(self, stretch: BeltStretch) -> None:
        """Add a stretch; one that lies before the newest row starts a new epoch."""
        if stretch.height_mm.shape[0] == 0 or stretch.x_mm.size == 0:
            return
        s = stretch.start_mm + np.arange(len(stretch.height_mm)) * stretch.cell_mm
        if not self._is_continuation(stretch):
            self._restart(stretch)
        row = np.floor(s / self._cell_mm + 1e-6).astype(np.int64)
        begins = np.flatnonzero(np.diff(row, prepend=row[0] - 1))
        known = np.isfinite(stretch.height_mm)
        sums = self._sum_cells(np.where(known, stretch.height_mm, 0), begins)
        counts, measured = self._sum_cells(known, begins), self._sum_cells(stretch.measured & known, begins)
        for number, total, count, good in zip(row[begins], sums, counts, measured, strict=True):
            self._add_row(_OpenRow(int(number), total, count, good))

    def _is_continuation(self, stretch: BeltStretch) -> bool:
        """Return whether the stretch has the same grid and does not lie before the newest row."""
        if self._source_x is None or not np.array_equal(self._source_x, stretch.x_mm):
            return False
        if stretch.cell_mm > self._cell_mm:
            return False
        return self._open.number is None or stretch.start_mm >= (self._open.number - 1) * self._cell_mm

    def _sum_cells(self, values: NDArray[np.generic], begins: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the sums of source cells over the coarse cells."""
        by_row = np.add.reduceat(values.astype(np.float64), begins, axis=0)
        return np.add.reduceat(by_row, self._first_of_column, axis=1)

    def _add_row(self, row: _OpenRow) -> None:
        if self._open.number is None:
            self._open = row
        elif row.number == self._open.number:
            self._open = self._open.merge(row)
        elif row.number is not None and row.number > self._open.number:
            self._close_row()
            self._open = row

    def _close_row(self) -> None:
        number = self._open.number
        assert number is not None
        rows = self._ring.shape[0]
        if self._end is not None:  # rows between two stretches are unknown
            for missing in range(max(self._end, number - rows), number):
                self._ring[missing % rows] = UNKNOWN
        self._ring[number % rows] = self._open.encode()
        self._end = number + 1
        if self._begin is None:
            self._begin = number

    @property
    def mark(self) -> tuple[int, int]:
        """(epoch, number after the last row)."""
        return self._epoch, self._end or 0

    def get_rows_after(self, mark: tuple[int, int] | None = None) -> BeltRows | None:
        """Return the kept rows since ``mark``; None if there are none."""
        if self._begin is None or self._end is None or mark == self.mark:
            return None
        rows = self._ring.shape[0]
        first = max(self._begin, self._end - rows)
        if mark is not None and mark[0] == self._epoch:
            first = max(first, mark[1])
        if first >= self._end:
            return None
        counts = self._ring[np.arange(first, self._end) % rows]
        return BeltRows(self._epoch, first, self._cell_mm, self._x_mm.astype(np.float32), counts)


@dataclass(frozen=True, slots=True, eq=False)
class _OpenRow:
    """A row of coarse cells that may still grow."""

    number: int | None
    total: NDArray[np.float64]
    count: NDArray[np.float64]
    measured: NDArray[np.float64]

    @classmethod
    def make_empty(cls) -> _OpenRow:
        empty = np.zeros(0)
        return cls(None, empty, empty, empty)

    def merge(self, other: _OpenRow) -> _OpenRow:
        return _OpenRow(
            self.number, self.total + other.total, self.count + other.count, self.measured + other.measured
        )

    def encode(self) -> NDArray[np.uint16]:
        """Return the encoded means; a cell counts as measured if at least half of its source cells are."""
        mean = np.divide(self.total, self.count, out=np.full(self.total.shape, np.nan), where=self.count > 0)
        return encode_heights(mean, self.measured * 2 >= np.maximum(self.count, 1))
