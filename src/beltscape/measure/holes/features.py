"""The outlook of hole cells in numbers that depend on neither units nor the size of what lies there."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.measure.holes.outlook import WINDOWS, Expected, Outlook
from beltscape.measure.holes.quadrics import Quadrics
from beltscape.measure.holes.rims import Lowest
from beltscape.measure.holes.windows import Place, WindowSums, bands

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
_LEAST_SHARE = 1e-3
"""A window of which less is known tells nothing."""
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
    value_mm: NDArray[np.float64], calm_mm: NDArray[np.float64], place: Place, cell_mm: float
) -> Around:
    """Windows about the hole cells ``place`` of a field (Ny, Nx), ``calm_mm`` the same without flying pixels."""
    hole = ~np.isfinite(value_mm)
    known_mm = np.where(hole, np.inf, calm_mm)
    # about the field's own middle: so differences do not drown in rounding
    middle = float(np.nanmean(value_mm))
    bend = _bends(value_mm, 2 * cell_mm)
    found = np.empty((len(_OPEN_CELLS) + len(WINDOWS) + len(_LOW_CELLS) + len(_ROUGH_CELLS), len(place[0])))
    for own, near in bands(place, max(WINDOWS) // 2, len(hole)):
        at = (place[0][own] - near.start, place[1][own])
        heights, bends = _Means(value_mm[near] - middle), _Means(bend[near])
        found[:, own] = [
            *(1 - heights.share(at, side) for side in _OPEN_CELLS),
            *(middle + heights.mean(at, side) for side in WINDOWS),
            *(_lowest(known_mm[near], at, side) for side in _LOW_CELLS),
            *(np.nan_to_num(bends.mean(at, side)) for side in _ROUGH_CELLS),
        ]
    groups = np.cumsum([len(_OPEN_CELLS), len(WINDOWS), len(_LOW_CELLS)])
    deep = np.asarray(ndimage.distance_transform_edt(hole), np.float64)[place]
    return Around(*np.split(found, groups), deep)


class _Means:
    """Means of what is known of a field (Ny, Nx) in windows; its border goes on outside."""

    def __init__(self, field: NDArray[np.float64]) -> None:
        padded = np.pad(field, self._EDGE, mode="edge")
        known = np.isfinite(padded)
        self._counts = WindowSums(known[None].astype(np.int64))
        self._totals = WindowSums(np.where(known, padded, 0.0)[None])

    _EDGE = max(WINDOWS) // 2

    def share(self, place: Place, side: int) -> NDArray[np.float64]:
        """(H,) share of known cells."""
        return self._counts.at(self._moved(place), side)[0] / side**2

    def mean(self, place: Place, side: int) -> NDArray[np.float64]:
        """(H,) NaN where next to nothing is known."""
        share = self.share(place, side)
        total = self._totals.at(self._moved(place), side)[0] / side**2
        return np.where(share > _LEAST_SHARE, total / np.maximum(share, _LEAST_SHARE), np.nan)

    def _moved(self, place: Place) -> Place:
        return place[0] + self._EDGE, place[1] + self._EDGE


def _lowest(known_mm: NDArray[np.float64], place: Place, side: int) -> NDArray[np.float64]:
    """(H,) lowest cell in windows of a field (Ny, Nx) with inf in its holes; NaN where there is none."""
    first, end = int(place[0].min()), int(place[0].max()) + 1
    rows = ndimage.minimum_filter1d(known_mm, side, axis=0, mode="nearest")[first:end]
    low = ndimage.minimum_filter1d(rows, side, axis=1, mode="nearest")[place[0] - first, place[1]]
    return np.where(np.isfinite(low), low, np.nan)


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
    return np.clip(np.nan_to_num(over / under, nan=0, posinf=0, neginf=0), -_MOST, _MOST)


def _angle(rise: NDArray[np.float64], run: NDArray[np.float64] | float) -> NDArray[np.float64]:
    return np.arctan(np.nan_to_num(rise / run, nan=0, posinf=0, neginf=0))
