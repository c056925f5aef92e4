"""A splice in one frame: a band of even height across the belt, also where a load hides a part of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.health.belt.residue import (
    EVEN_MM,
    EVEN_SHARE,
    HIGHEST_MM,
    HIGHEST_RIDGE_MM,
    LEAST_RIDGE_MM,
    CellRows,
)

_SLOPES = np.tan(np.deg2rad(np.arange(-60.0, 61.0, 2.5)))
"""Slopes of a splice to the line across the belt that are tried; 22° is usual, more than 45° is not made."""
_LEAST_PURE = 0.85
"""Least share of the cells in the band that are as high as it, and of the cells as high that are in the band."""
_LEAST_CELLS = 24
"""Least number of raised cells; fewer are a single cake."""
_LEAST_SPAN = 0.8
"""Least share of the belt's width that the raised cells reach over; a load may hide some between them."""
_LEAST_BESIDE = 6
"""Least number of bare cells before and behind the band, which show both of its ends."""
_LOADED = 0.1
"""Share of the band that is hidden, from which a load lies on it."""
_LEVELS = 24
"""Number of heights that are tried."""


@dataclass(frozen=True, slots=True, eq=False)
class SpliceBand:
    """A splice of which both ends are in view."""

    height_mm: float
    middle_mm: float
    """y of its middle, at the middle of the belt's width."""
    length_mm: float
    """Along the belt."""
    is_loaded: bool
    """Whether a load hides a part of it."""
    raised: NDArray[np.bool_]
    """(n, m) cells that show it."""


def find_splice(rows: CellRows) -> SpliceBand | None:
    """Return the splice in the cells of a frame; None without one whose two ends are in view."""
    over, side = rows.over_mm, rows.side_mm
    height = _find_level(over, rows.bare)
    if height is None:
        return None
    tolerance = max(EVEN_SHARE * height, EVEN_MM)
    raised = ~rows.bare & (np.abs(np.nan_to_num(over, nan=np.inf) - height) <= tolerance)
    low = np.isfinite(over) & (over <= HIGHEST_MM)
    columns = np.flatnonzero(raised.sum(axis=0))
    if raised.sum() < _LEAST_CELLS or np.ptp(columns) < _LEAST_SPAN * (over.shape[1] - 1):
        return None
    x = side * (np.arange(over.shape[1], dtype=np.float64) - 0.5 * (over.shape[1] - 1))
    along: list[NDArray[np.float64]] = [rows.y_mm[:, None] - slope * x for slope in _SLOPES]
    bands = [_find_band(u, raised, low) for u in along]
    best = max(range(len(bands)), key=lambda number: bands[number][0])
    u, (score, first, last) = along[best], bands[best]
    inside = (u >= first) & (u <= last)
    own = raised & inside
    if score <= 0 or own.sum() < _LEAST_PURE * max((low & inside).sum(), raised.sum()):
        return None
    if min((rows.bare & (u < first)).sum(), (rows.bare & (u > last)).sum()) < _LEAST_BESIDE:
        return None
    is_loaded = bool((inside & ~low).sum() > _LOADED * inside.sum())
    return SpliceBand(float(np.median(over[own])), 0.5 * (first + last), last - first + side, is_loaded, own)


def _find_level(over_mm: NDArray[np.float64], bare: NDArray[np.bool_]) -> float | None:
    """Return the height that most cells above the belt have in common; None without such cells."""
    heights = over_mm[~bare & (over_mm >= LEAST_RIDGE_MM) & (over_mm <= HIGHEST_RIDGE_MM)]
    if len(heights) < _LEAST_CELLS:
        return None
    levels = np.quantile(heights, np.linspace(0, 1, _LEVELS))
    tolerance = np.maximum(EVEN_SHARE * levels, EVEN_MM)
    near = (np.abs(heights - levels[:, None]) <= tolerance[:, None] / 2).sum(axis=1)
    level = levels[int(np.argmax(near))]
    return float(np.median(heights[np.abs(heights - level) <= max(EVEN_SHARE * level, EVEN_MM) / 2]))


def _find_band(
    u_mm: NDArray[np.float64], raised: NDArray[np.bool_], low: NDArray[np.bool_]
) -> tuple[float, float, float]:
    """Return the interval of u with most raised cells less others, as score, first and last u of its cells."""
    u = u_mm[low]
    order = np.argsort(u)
    gain = np.cumsum(np.where(raised[low][order], 1, -1))
    before = np.minimum.accumulate(np.concatenate([[0], gain[:-1]]))
    last = int(np.argmax(gain - before))
    first = int(np.argmin(np.concatenate([[0], gain[:last]])))
    return float(gain[last] - before[last]), float(u[order[first]]), float(u[order[last]])
