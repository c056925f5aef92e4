"""The outlook of hole cells in numbers that depend on neither units nor the size of what lies there."""

from __future__ import annotations

from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import load
from beltscape.kernels.arrays import CellIndices
from beltscape.measure.holes.quadrics import Quadrics
from beltscape.measure.holes.rim_profiles import WINDOWS, Expected, Outlook
from beltscape.measure.holes.rims import Lowest

_OPEN_CELLS = (5, 11, 25, 51)
"""Cells across the windows in which the share of holes counts."""
_LOW_CELLS = (11, 25, 51)
"""In which the lowest measured cell counts."""
_ROUGH_CELLS = (25, 71)
"""And in which roughness does."""
_BEND_CELLS = 2
"""Roughness is what a cell's height departs from the middle of those so far on both sides."""
_MOST = 4.0
"""Ratios count up to here."""
_MOST_LEVERAGE = 99.0
_BARE_CELLS = 3.0
"""What lies lower than some of these may be the bare belt."""


@dataclass(frozen=True, slots=True, eq=False)
class Around:
    """What is about H hole cells."""

    open: NDArray[np.float64]
    """(4, H) share of holes in windows of rising size."""
    mean_mm: NDArray[np.float64]
    """(K, H) mean of what was measured in the quadratics' windows; NaN where nothing was."""
    low_mm: NDArray[np.float64]
    """(3, H) the lowest measured cell in windows of rising size; NaN where nothing was."""
    rough_mm: NDArray[np.float64]
    """(2, H) mean size of the bends of the measured surface, of a cell's size at most."""
    depth_cells: NDArray[np.float64]
    """(H,) distance to the nearest measured cell."""


def around(
    value_mm: NDArray[np.float64], calm_mm: NDArray[np.float64], place: CellIndices, cell_mm: float
) -> Around:
    """Windows about the hole cells ``place`` of a field (Ny, Nx), ``calm_mm`` the same without flying pixels."""
    hole = ~np.isfinite(value_mm)
    # about the field's own middle: so differences do not drown in rounding
    middle = float(np.nanmean(value_mm))
    sides = tuple(sorted({*_OPEN_CELLS, *WINDOWS}))
    share, mean = load().window_means(value_mm - middle, place, sides)
    rough = load().window_means(_bends(value_mm, 2 * cell_mm), place, _ROUGH_CELLS).mean
    deep = cv2.distanceTransform(hole.view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return Around(
        1 - share[[sides.index(side) for side in _OPEN_CELLS]],
        middle + mean[[sides.index(side) for side in WINDOWS]],
        load().window_minima(calm_mm, place, _LOW_CELLS),
        np.nan_to_num(rough),
        # squares of distances are whole numbers; the last digit of OpenCV's roots differs from call to call
        np.sqrt(np.rint(deep[place].astype(np.float64) ** 2)),
    )


def _bends(value_mm: NDArray[np.float64], most_mm: float) -> NDArray[np.float64]:
    """(Ny, Nx) the greater of both axes' bends, up to ``most_mm``; NaN where none is measured."""
    k = _BEND_CELLS
    found = np.full(value_mm.shape, np.nan)
    for field, part in ((value_mm, found), (value_mm.T, found.T)):
        if len(field) > 2 * k:
            bend = np.abs(field[k:-k] - 0.5 * (field[2 * k :] + field[: -2 * k]))
            part[k:-k] = np.fmax(part[k:-k], bend)
    return np.minimum(found, most_mm)


def features(
    look: Outlook,
    lowest: Lowest,
    ahead: Expected,
    smooth: Quadrics,
    about: Around,
    pinhole: NDArray[np.bool_],
    slant: NDArray[np.float64],
    cell_mm: float,
) -> NDArray[np.float32]:
    """(H, F) float32 features: ratios of heights and lengths, angles, logarithms.

    ``pinhole`` (H,): a gap between neighbouring pixels' points; ``slant`` (H,): tangent of the rays' slant.
    """
    base, scale = ahead.base_mm, ahead.scale_mm
    floor, ceiling, shortest = look.floor_mm, look.ceiling_mm, look.shortest_mm(cell_mm)
    found = _of_lines(look, base, scale, shortest, cell_mm)
    found += [
        _ratio(floor - base, scale),
        _ratio(ceiling - base, scale),
        _angle(ceiling - floor, shortest),
        _angle(base, scale),
        _angle(floor, scale),
        _angle(base, shortest),
        _angle(floor, shortest),
        _angle(ahead.hollow_mm[0], shortest),
        _angle(ahead.hollow_mm[1], 4 * shortest),
        _ratio(ahead.hollow_mm[0], scale),
        np.log(np.clip(shortest / cell_mm, 1, 64)),
        slant,
        pinhole.astype(np.float64),
        _angle(floor, _BARE_CELLS * cell_mm),
        _angle(ceiling, _BARE_CELLS * cell_mm),
        _angle(scale, shortest),
        ahead.smooth,
        _ratio(look.straight_mm(cell_mm) - base, scale),
        *about.open,
        np.log(about.depth_cells),
    ]
    for k, side in enumerate(WINDOWS):
        miss = np.nan_to_num(smooth.miss_mm[k])
        leverage = np.nan_to_num(smooth.leverage[k], nan=_MOST_LEVERAGE)
        found += [
            _ratio(about.mean_mm[k] - base, scale),
            _ratio(smooth.value_mm[k] - base, scale),
            _ratio(smooth.miss_mm[k], scale),
            _angle(6 * miss, side * cell_mm),
            np.log(np.clip(leverage, 0.5, _MOST_LEVERAGE)),
        ]
    found += [rough / cell_mm for rough in about.rough_mm]
    found += _of_depths(lowest, about, look, ahead, cell_mm)
    return np.stack(found, axis=1).astype(np.float32)


def _of_lines(
    look: Outlook,
    base: NDArray[np.float64],
    scale: NDArray[np.float64],
    shortest: NDArray[np.float64],
    cell_mm: float,
) -> list[NDArray[np.float64]]:
    """Sixteen features of each of the five lines; where one met one rim only, what tells nothing."""
    found = []
    for k, tangents in enumerate(look.tangents_mm().transpose(1, 0, 2)):
        line = {part.name: getattr(look, part.name)[k] for part in fields(look)}
        both = np.isfinite(line["gap_mm"])
        gap = np.where(both, line["gap_mm"], 1.0)
        drop = np.where(both, line["upper_mm"] - line["lower_mm"], 0.0)
        nearer = np.minimum(line["share"], 1 - line["share"])
        found += [
            (~both).astype(np.float64),
            np.where(both, _ratio(line["upper_mm"] - base, scale), 0.0),
            np.where(both, _ratio(line["lower_mm"] - base, scale), 0.0),
            _angle(drop, gap),
            line["share"],
            np.arctan(line["upper_slope"]),
            np.arctan(line["lower_slope"]),
            _ratio(np.maximum(line["away"], 0) * drop, gap),
            line["away"],
            np.where(both, np.log(gap / shortest), 2.0),
            np.where(both, nearer * gap / shortest, 1.0),
            _ratio(tangents[0] - base, scale),
            _ratio(tangents[1] - base, scale),
            np.arctan(line["upper_rise"]),
            np.arctan(line["lower_rise"]),
            np.where(both, np.log(gap / cell_mm), 4.0),
        ]
    return found


def _of_depths(
    lowest: Lowest, about: Around, look: Outlook, ahead: Expected, cell_mm: float
) -> list[NDArray[np.float64]]:
    """How deep it is elsewhere in the hole and near it."""
    base, scale, shortest = ahead.base_mm, ahead.scale_mm, look.shortest_mm(cell_mm)
    both = np.isfinite(lowest.upper_mm)
    beneath = np.where(look.met, look.lower_mm, np.nan)[1]  # of the shortest line
    found = [
        np.where(both, _ratio(lowest.upper_mm - base, scale), 0.0),
        np.where(both, _ratio(lowest.lower_mm - base, scale), 0.0),
        np.where(both, np.log(np.where(both, lowest.gap_mm, 1.0) / shortest), 2.0),
        np.where(both, np.log(np.where(both, lowest.gap_mm, 1.0) / cell_mm), 4.0),
        np.nan_to_num(lowest.nearer),
        _angle(beneath - lowest.upper_mm, shortest),
    ]
    for low in about.low_mm:
        found += [
            _ratio(low - base, scale),
            _angle(low - look.floor_mm, shortest),
            _angle(beneath - low, shortest),
        ]
    return found


def _ratio(over: NDArray[np.float64], under: NDArray[np.float64]) -> NDArray[np.float64]:
    ratio = over / under
    return np.clip(np.where(np.isfinite(ratio), ratio, 0.0), -_MOST, _MOST)


def _angle(rise: NDArray[np.float64], run: NDArray[np.float64] | float) -> NDArray[np.float64]:
    slope = rise / run
    return np.arctan(np.where(np.isfinite(slope), slope, 0.0))
