"""Features of hole cells for the networks, independent of the unit of length and of the size of the load."""

from __future__ import annotations

from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import load
from beltscape.kernels.arrays import CellIndices
from beltscape.measure.holes.quadrics import Quadrics
from beltscape.measure.holes.rim_profiles import WINDOWS, RimProfiles, SmoothSurface
from beltscape.measure.holes.rims import LowestLine

_OPEN_CELLS = (5, 11, 25, 51)
"""Cells across the windows in which the share of hole cells is computed."""
_LOW_CELLS = (11, 25, 51)
"""Cells across the windows in which the lowest measured cell is found."""
_ROUGH_CELLS = (25, 71)
"""Cells across the windows in which roughness is averaged."""
_BEND_CELLS = 2
"""Roughness is a cell's deviation from the mean of the two cells at this distance on both sides."""
_MOST = 4.0
"""Ratios are clipped to this."""
_MOST_LEVERAGE = 99.0
"""Leverage where no quadric was fitted, and its largest value."""
_BARE_CELLS = 3.0
"""Unit of heights over the belt: a few of these separate the bare belt from a load."""


@dataclass(frozen=True, slots=True, eq=False)
class HoleNeighbourhood:
    """Statistics of the neighbourhood of H hole cells."""

    open: NDArray[np.float64]
    """(4, H) share of hole cells in windows of ascending size."""
    mean_mm: NDArray[np.float64]
    """(K, H) mean of the measured cells in the quadratics' windows; NaN where there are none."""
    low_mm: NDArray[np.float64]
    """(3, H) the lowest measured cell in windows of ascending size; NaN where there is none."""
    rough_mm: NDArray[np.float64]
    """(2, H) mean roughness of the measured surface, each cell's limited to two cells' size."""
    depth_cells: NDArray[np.float64]
    """(H,) distance to the nearest measured cell."""


def measure_neighbourhood(
    value_mm: NDArray[np.float64], filtered_mm: NDArray[np.float64], cells: CellIndices, cell_mm: float
) -> HoleNeighbourhood:
    """Measure around the hole ``cells`` of a field (Ny, Nx); ``filtered_mm`` is the field without flying pixels."""
    hole = ~np.isfinite(value_mm)
    # relative to the field's mean, so that differences keep their precision
    middle = float(np.nanmean(value_mm))
    sides = tuple(sorted({*_OPEN_CELLS, *WINDOWS}))
    share, mean = load().window_means(value_mm - middle, cells, sides)
    rough = load().window_means(_compute_roughness(value_mm, 2 * cell_mm), cells, _ROUGH_CELLS).mean
    deep = cv2.distanceTransform(hole.view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return HoleNeighbourhood(
        1 - share[[sides.index(side) for side in _OPEN_CELLS]],
        middle + mean[[sides.index(side) for side in WINDOWS]],
        load().window_minima(filtered_mm, cells, _LOW_CELLS),
        np.nan_to_num(rough),
        # squared distances are integers; the last digit of OpenCV's square roots differs between calls
        np.sqrt(np.rint(deep[cells].astype(np.float64) ** 2)),
    )


def _compute_roughness(value_mm: NDArray[np.float64], most_mm: float) -> NDArray[np.float64]:
    """Return the larger second difference (Ny, Nx) of both axes, up to ``most_mm``; NaN where none is measured."""
    k = _BEND_CELLS
    result = np.full(value_mm.shape, np.nan)
    for field, part in ((value_mm, result), (value_mm.T, result.T)):
        if len(field) > 2 * k:
            bend = np.abs(field[k:-k] - 0.5 * (field[2 * k :] + field[: -2 * k]))
            part[k:-k] = np.fmax(part[k:-k], bend)
    return np.minimum(result, most_mm)


def compute_features(
    profiles: RimProfiles,
    lowest: LowestLine,
    surface: SmoothSurface,
    quadric_fits: Quadrics,
    neighbourhood: HoleNeighbourhood,
    pinhole: NDArray[np.bool_],
    ray_slope: NDArray[np.float64],
    cell_mm: float,
) -> NDArray[np.float32]:
    """Return the features (H, F) float32: ratios of heights and lengths, angles, logarithms.

    ``pinhole`` (H,) marks gaps between the points of neighbouring pixels; ``ray_slope`` (H,) is the rays' slope.
    """
    base, scale = surface.base_mm, surface.scale_mm
    floor, ceiling, shortest = profiles.floor_mm, profiles.ceiling_mm, profiles.shortest_mm(cell_mm)
    result = _compute_line_features(profiles, base, scale, shortest, cell_mm)
    result += [
        _ratio(floor - base, scale),
        _ratio(ceiling - base, scale),
        _angle(ceiling - floor, shortest),
        _angle(base, scale),
        _angle(floor, scale),
        _angle(base, shortest),
        _angle(floor, shortest),
        _angle(surface.structure_mm[0], shortest),
        _angle(surface.structure_mm[1], 4 * shortest),
        _ratio(surface.structure_mm[0], scale),
        np.log(np.clip(shortest / cell_mm, 1, 64)),
        ray_slope,
        pinhole.astype(np.float64),
        _angle(floor, _BARE_CELLS * cell_mm),
        _angle(ceiling, _BARE_CELLS * cell_mm),
        _angle(scale, shortest),
        surface.smooth,
        _ratio(profiles.straight_mm(cell_mm) - base, scale),
        *neighbourhood.open,
        np.log(neighbourhood.depth_cells),
    ]
    for k, side in enumerate(WINDOWS):
        rms = np.nan_to_num(quadric_fits.rms_mm[k])
        leverage = np.nan_to_num(quadric_fits.leverage[k], nan=_MOST_LEVERAGE)
        result += [
            _ratio(neighbourhood.mean_mm[k] - base, scale),
            _ratio(quadric_fits.value_mm[k] - base, scale),
            _ratio(quadric_fits.rms_mm[k], scale),
            _angle(6 * rms, side * cell_mm),
            np.log(np.clip(leverage, 0.5, _MOST_LEVERAGE)),
        ]
    result += [rough / cell_mm for rough in neighbourhood.rough_mm]
    result += _compute_depth_features(lowest, neighbourhood, profiles, surface, cell_mm)
    return np.stack(result, axis=1).astype(np.float32)


def _compute_line_features(
    profiles: RimProfiles,
    base: NDArray[np.float64],
    scale: NDArray[np.float64],
    shortest: NDArray[np.float64],
    cell_mm: float,
) -> list[NDArray[np.float64]]:
    """Return sixteen features of each of the five lines; neutral values where a line has only one rim."""
    result: list[NDArray[np.float64]] = []
    for k, tangents in enumerate(profiles.tangents_mm().transpose(1, 0, 2)):
        line = {part.name: getattr(profiles, part.name)[k] for part in fields(profiles)}
        both = np.isfinite(line["gap_mm"])
        gap = np.where(both, line["gap_mm"], 1.0)
        drop = np.where(both, line["upper_mm"] - line["lower_mm"], 0.0)
        nearer = np.minimum(line["share"], 1 - line["share"])
        result += [
            (~both).astype(np.float64),
            np.where(both, _ratio(line["upper_mm"] - base, scale), 0.0),
            np.where(both, _ratio(line["lower_mm"] - base, scale), 0.0),
            _angle(drop, gap),
            line["share"],
            np.arctan(line["upper_slope"]),
            np.arctan(line["lower_slope"]),
            _ratio(np.maximum(line["ray_slope"], 0) * drop, gap),
            line["ray_slope"],
            np.where(both, np.log(gap / shortest), 2.0),
            np.where(both, nearer * gap / shortest, 1.0),
            _ratio(tangents[0] - base, scale),
            _ratio(tangents[1] - base, scale),
            np.arctan(line["upper_rise"]),
            np.arctan(line["lower_rise"]),
            np.where(both, np.log(gap / cell_mm), 4.0),
        ]
    return result


def _compute_depth_features(
    lowest: LowestLine,
    neighbourhood: HoleNeighbourhood,
    profiles: RimProfiles,
    surface: SmoothSurface,
    cell_mm: float,
) -> list[NDArray[np.float64]]:
    """Return features of the depth elsewhere in the hole and near it."""
    base, scale, shortest = surface.base_mm, surface.scale_mm, profiles.shortest_mm(cell_mm)
    both = np.isfinite(lowest.upper_mm)
    beneath = np.where(profiles.has_both_rims, profiles.lower_mm, np.nan)[1]  # of the shortest line
    result = [
        np.where(both, _ratio(lowest.upper_mm - base, scale), 0.0),
        np.where(both, _ratio(lowest.lower_mm - base, scale), 0.0),
        np.where(both, np.log(np.where(both, lowest.gap_mm, 1.0) / shortest), 2.0),
        np.where(both, np.log(np.where(both, lowest.gap_mm, 1.0) / cell_mm), 4.0),
        np.nan_to_num(lowest.nearer),
        _angle(beneath - lowest.upper_mm, shortest),
    ]
    for low in neighbourhood.low_mm:
        result += [
            _ratio(low - base, scale),
            _angle(low - profiles.floor_mm, shortest),
            _angle(beneath - low, shortest),
        ]
    return result


def _ratio(over: NDArray[np.float64], under: NDArray[np.float64]) -> NDArray[np.float64]:
    ratio = over / under
    return np.clip(np.where(np.isfinite(ratio), ratio, 0.0), -_MOST, _MOST)


def _angle(rise: NDArray[np.float64], run: NDArray[np.float64] | float) -> NDArray[np.float64]:
    slope = rise / run
    return np.arctan(np.where(np.isfinite(slope), slope, 0.0))
