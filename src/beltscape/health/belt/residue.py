"""Material stuck to the belt, carry-back and spillage: on an otherwise empty belt, and on the strips beside a load.

On an empty belt one frame shows it. Beside a load it shows over some metres while the belt is never empty.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.health.belt.cells import BeltCells
from beltscape.health.belt.zero_shift import ZeroShift

_LEAST_BARE = 0.5
"""Least share of a row's cells that is bare on an otherwise empty stretch."""
_LEAST_MEASURED = 0.6
"""Least share of a row's cells that must be measured; steep cakes hide some."""
HIGHEST_MM = 20.0
"""Higher material is a load, if a thin one, and not carry-back: cakes that stick are some millimetres high."""
LEAST_RIDGE_MM, HIGHEST_RIDGE_MM = 0.6, 15.0
"""Heights of a splice, with its fasteners, over the belt around it."""
EVEN_SHARE, EVEN_MM = 0.3, 0.4
"""A splice is as high across the belt: most cells lie within this share of its height, or this many mm."""
_LEAST_EVEN = 0.7
"""Least share of the measured cells that are."""
_FAR_MM = 1e9
"""Stands for a cell that was not measured."""
_MARGIN_MM, _MARGIN_SHARE = 200.0, 0.3
"""Rows this close to a load may hold its thin ends; at most this share of the view."""


@dataclass(frozen=True, slots=True, eq=False)
class CellRows:
    """Rows of cells across the belt, in the order of y."""

    y_mm: NDArray[np.float64]
    """(n,) middles."""
    over_mm: NDArray[np.float64]
    """(n, m) heights over the belt as it lies; NaN: not measured."""
    sigma_mm: NDArray[np.float64]
    """(n, m) one standard deviation of them, independent between cells; NaN: not measured."""
    bare: NDArray[np.bool_]
    """(n, m) which cells show the bare belt."""
    side_mm: float
    """Edge of a cell."""

    @property
    def is_empty(self) -> NDArray[np.bool_]:
        """Return which rows (n,) are empty except for material stuck to the belt, with no load near them in view."""
        known = np.isfinite(self.over_mm)
        number = np.maximum(known.sum(axis=1), 1)
        is_bare = (self.bare.sum(axis=1) >= _LEAST_BARE * number) | (self.ridge_mm > 0)
        is_low = (np.nan_to_num(self.over_mm) <= HIGHEST_MM).all(axis=1)
        empty = (known.mean(axis=1) >= _LEAST_MEASURED) & is_bare & is_low
        near_load = ndimage.binary_dilation(~empty, np.ones(2 * self.margin + 1))
        return empty & ~np.asarray(near_load, bool)

    @property
    def ridge_mm(self) -> NDArray[np.float64]:
        """Return the height (n,) of a ridge that is even across the belt, such as a splice; 0: there is none."""
        known = np.isfinite(self.over_mm)
        number = known.sum(axis=1)
        filled = np.where(known, self.over_mm, _FAR_MM)
        height = np.sort(filled, axis=1)[np.arange(len(filled)), np.maximum(number - 1, 0) // 2]
        tolerance = np.maximum(EVEN_SHARE * height, EVEN_MM)
        even = (np.abs(filled - height[:, None]) <= tolerance[:, None]).sum(axis=1) >= _LEAST_EVEN * number
        is_ridge = (number >= _LEAST_MEASURED * known.shape[1]) & even
        is_ridge &= (height >= LEAST_RIDGE_MM) & (height <= HIGHEST_RIDGE_MM)
        return np.where(is_ridge, height, 0.0)

    @property
    def margin(self) -> int:
        """Return the number of rows beside a load that count as part of it."""
        return round(min(_MARGIN_MM / self.side_mm, _MARGIN_SHARE * len(self.y_mm)))

    @property
    def area_mm2(self) -> NDArray[np.float64]:
        """Return the cross-section (n,) of the material on the belt: of the cells that are not bare."""
        return self.side_mm * np.where(self.bare, 0.0, np.clip(np.nan_to_num(self.over_mm), 0, None)).sum(
            axis=1
        )


def arrange_rows(cells: BeltCells, shift: ZeroShift) -> CellRows:
    """Return the cells of a frame as rows over the belt as it lies."""
    over, sigma = np.full(cells.shape, np.nan), np.full(cells.shape, np.nan)
    bare = np.zeros(cells.shape, bool)
    place = cells.row, cells.column
    over[place], sigma[place], bare[place] = shift.over_mm, cells.sigma_mm, shift.bare
    first = cells.y_middle_mm - 0.5 * (cells.y_extent_mm - cells.side_mm)
    y = first + cells.side_mm * np.arange(cells.shape[0], dtype=np.float64)
    return CellRows(y, over, sigma, bare, cells.side_mm)


def measure_residue(rows: CellRows, shift: ZeroShift) -> tuple[float, float]:
    """Return the mean cross-section of material on the empty stretches in view and its σ, mm²; NaN without one."""
    empty = rows.is_empty
    if not shift.is_measured or empty.sum() < 0.5 * len(empty):
        return float("nan"), float("nan")
    own = np.where(rows.bare, 0.0, np.nan_to_num(rows.sigma_mm))[empty]
    independent = rows.side_mm * np.sqrt((own**2).sum()) / empty.sum()
    width = rows.side_mm * float((np.isfinite(rows.over_mm) & ~rows.bare)[empty].sum(axis=1).mean())
    return float(rows.area_mm2[empty].mean()), float(np.hypot(independent, shift.sigma_mm * width))


_AWAY_MM = 40.0
"""Distance from the load at which its edge has ended: in a simulated load 0.07 mm on average lie farther out."""
_LEAST_STRIP = 2
"""Least number of measured cells of a strip."""
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class BesideLoad:
    """Mean thickness of the layer on the strips beside the load; NaN: too little of them was seen."""

    thickness_mm: float
    """Of the strip with less of it: a load that lies too far to one side covers only one."""
    strip_mm: float
    """Width of both strips together."""


class StripAverage:
    """Averages the strips' rows, each once, over a length of the belt."""

    def __init__(self, side_mm: float, length_mm: float) -> None:
        """``length_mm`` must have been seen before there is an average."""
        self._side_mm = side_mm
        self._rows: deque[NDArray[np.float64]] = deque(maxlen=max(1, round(length_mm / side_mm)))

    def add(self, row: NDArray[np.float64]) -> None:
        """Add a row of `measure_strips` (4,); one without both strips is left out."""
        if (row[2:] >= _LEAST_STRIP).all():
            self._rows.append(row)

    @property
    def average(self) -> BesideLoad:
        """Return the average over the length."""
        if len(self._rows) < (self._rows.maxlen or 0):
            return BesideLoad(_NAN, _NAN)
        total = np.sum(self._rows, axis=0)
        strip = float(total[2:].sum() / len(self._rows)) * self._side_mm
        return BesideLoad(float((total[:2] / total[2:]).min()), strip)


def measure_strips(rows: CellRows) -> NDArray[np.float64]:
    """Return for each row (n, 4) the sums of the heights on the left and right strip, mm, and the numbers of cells.

    The strips of a row lie outside of its load; a row without a load has none.
    """
    known = np.isfinite(rows.over_mm)
    load = known & (np.nan_to_num(rows.over_mm) > HIGHEST_MM)
    reach = 2 * round(_AWAY_MM / rows.side_mm) + 1
    near = np.asarray(ndimage.binary_dilation(load, np.ones((reach, reach))), bool)
    loaded = (load.sum(axis=1) > 0)[:, None]
    left = loaded & known & ~np.maximum.accumulate(near, axis=1)
    right = loaded & known & ~np.maximum.accumulate(near[:, ::-1], axis=1)[:, ::-1]
    material = np.where(rows.bare, 0.0, np.clip(np.nan_to_num(rows.over_mm), 0, None))
    sums = [np.where(strip, material, 0.0).sum(axis=1) for strip in (left, right)]
    return np.stack([*sums, left.sum(axis=1), right.sum(axis=1)], axis=-1)
