"""Material on the strips beside a load over some metres: carry-back shows there while the belt is never empty."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.health.belt.residue import HIGHEST_MM, BeltRows

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


def measure_strips(rows: BeltRows) -> NDArray[np.float64]:
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
