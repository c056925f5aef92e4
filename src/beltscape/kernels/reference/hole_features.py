"""Features of hole cells for the networks, independent of the unit of length and of the size of the load."""

from __future__ import annotations

from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.arrays import CellIndices
from beltscape.kernels.holes import (
    BARE_CELLS,
    BEND_CELLS,
    LINES,
    LOW_CELLS,
    MOST_RATIO,
    NO_LEVERAGE,
    OPEN_CELLS,
    ROUGH_CELLS,
    WINDOWS,
)
from beltscape.kernels.reference.hole_rims import LowestLine, Quadrics, RimProfiles, SmoothSurface
from beltscape.kernels.reference.windows import window_means, window_minima


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
    sides = tuple(sorted({*OPEN_CELLS, *WINDOWS}))
    share, mean = window_means(value_mm - middle, cells, sides)
    rough = window_means(_compute_roughness(value_mm, 2 * cell_mm), cells, ROUGH_CELLS)[1]
    deep = cv2.distanceTransform(hole.view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return HoleNeighbourhood(
        1 - share[[sides.index(side) for side in OPEN_CELLS]],
        middle + mean[[sides.index(side) for side in WINDOWS]],
        window_minima(filtered_mm, cells, LOW_CELLS),
        np.nan_to_num(rough),
        # squared distances are integers; the last digit of OpenCV's square roots differs between calls
        np.sqrt(np.rint(deep[cells].astype(np.float64) ** 2)),
    )


def _compute_roughness(value_mm: NDArray[np.float64], most_mm: float) -> NDArray[np.float64]:
    """Return the larger second difference (Ny, Nx) of both axes, up to ``most_mm``; NaN where none is measured."""
    k = BEND_CELLS
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
) -> dict[str, NDArray[np.float64]]:
    """Return the features (H,) by name: ratios of heights and lengths, angles, logarithms.

    ``pinhole`` (H,) marks gaps between the points of neighbouring pixels; ``ray_slope`` (H,) is the rays' slope.
    """
    base, scale = surface.base_mm, surface.scale_mm
    floor, ceiling, shortest = profiles.floor_mm, profiles.ceiling_mm, profiles.shortest_mm(cell_mm)
    result = _compute_line_features(profiles, base, scale, shortest, cell_mm)
    result |= {
        "floor": _ratio(floor - base, scale),
        "ceiling": _ratio(ceiling - base, scale),
        "range angle": _angle(ceiling - floor, shortest),
        "base over scale": _angle(base, scale),
        "floor over scale": _angle(floor, scale),
        "base over gap": _angle(base, shortest),
        "floor over gap": _angle(floor, shortest),
        "structure of the gap": _angle(surface.structure_mm[0], shortest),
        "structure of four gaps": _angle(surface.structure_mm[1], 4 * shortest),
        "structure over scale": _ratio(surface.structure_mm[0], scale),
        "log gap": np.log(np.clip(shortest / cell_mm, 1, 64)),
        "ray slope": ray_slope,
        "pinhole": pinhole.astype(np.float64),
        "floor over belt": _angle(floor, BARE_CELLS * cell_mm),
        "ceiling over belt": _angle(ceiling, BARE_CELLS * cell_mm),
        "scale over gap": _angle(scale, shortest),
        "smooth": surface.smooth,
        "straight line": _ratio(profiles.straight_mm(cell_mm) - base, scale),
        **{
            f"hole share within {side}": share
            for side, share in zip(OPEN_CELLS, neighbourhood.open, strict=True)
        },
        "log depth": np.log(neighbourhood.depth_cells),
    }
    for k, side in enumerate(WINDOWS):
        rms = np.nan_to_num(quadric_fits.rms_mm[k])
        leverage = np.nan_to_num(quadric_fits.leverage[k], nan=NO_LEVERAGE)
        result |= {
            f"mean within {side}": _ratio(neighbourhood.mean_mm[k] - base, scale),
            f"quadric within {side}": _ratio(quadric_fits.value_mm[k] - base, scale),
            f"quadric rms within {side}": _ratio(quadric_fits.rms_mm[k], scale),
            f"quadric rms angle within {side}": _angle(6 * rms, side * cell_mm),
            f"log leverage within {side}": np.log(np.clip(leverage, 0.5, NO_LEVERAGE)),
        }
    for side, rough in zip(ROUGH_CELLS, neighbourhood.rough_mm, strict=True):
        result[f"roughness within {side}"] = rough / cell_mm
    return result | _compute_depth_features(lowest, neighbourhood, profiles, surface, cell_mm)


def _compute_line_features(
    profiles: RimProfiles,
    base: NDArray[np.float64],
    scale: NDArray[np.float64],
    shortest: NDArray[np.float64],
    cell_mm: float,
) -> dict[str, NDArray[np.float64]]:
    """Return sixteen features of each of the five lines; neutral values where a line has only one rim."""
    result: dict[str, NDArray[np.float64]] = {}
    for k, tangents in enumerate(profiles.tangents_mm().transpose(1, 0, 2)):
        name = LINES[k]
        line = {part.name: getattr(profiles, part.name)[k] for part in fields(profiles)}
        both = np.isfinite(line["gap_mm"])
        gap = np.where(both, line["gap_mm"], 1.0)
        drop = np.where(both, line["upper_mm"] - line["lower_mm"], 0.0)
        nearer = np.minimum(line["share"], 1 - line["share"])
        values = {
            "one rim": (~both).astype(np.float64),
            "upper rim": np.where(both, _ratio(line["upper_mm"] - base, scale), 0.0),
            "lower rim": np.where(both, _ratio(line["lower_mm"] - base, scale), 0.0),
            "drop": _angle(drop, gap),
            "place": line["share"],
            "upper slope": np.arctan(line["upper_slope"]),
            "lower slope": np.arctan(line["lower_slope"]),
            "shadow": _ratio(np.maximum(line["ray_slope"], 0) * drop, gap),
            "ray slope": line["ray_slope"],
            "relative gap": np.where(both, np.log(gap / shortest), 2.0),
            "distance to the nearer rim": np.where(both, nearer * gap / shortest, 1.0),
            "upper tangent": _ratio(tangents[0] - base, scale),
            "lower tangent": _ratio(tangents[1] - base, scale),
            "upper rise": np.arctan(line["upper_rise"]),
            "lower rise": np.arctan(line["lower_rise"]),
            "log gap": np.where(both, np.log(gap / cell_mm), 4.0),
        }
        result |= {f"{name}: {feature}": value for feature, value in values.items()}
    return result


def _compute_depth_features(
    lowest: LowestLine,
    neighbourhood: HoleNeighbourhood,
    profiles: RimProfiles,
    surface: SmoothSurface,
    cell_mm: float,
) -> dict[str, NDArray[np.float64]]:
    """Return features of the depth elsewhere in the hole and near it."""
    base, scale, shortest = surface.base_mm, surface.scale_mm, profiles.shortest_mm(cell_mm)
    both = np.isfinite(lowest.upper_mm)
    beneath = np.where(profiles.has_both_rims, profiles.lower_mm, np.nan)[1]  # of the shortest line
    result: dict[str, NDArray[np.float64]] = {
        "lowest line: upper rim": np.where(both, _ratio(lowest.upper_mm - base, scale), 0.0),
        "lowest line: lower rim": np.where(both, _ratio(lowest.lower_mm - base, scale), 0.0),
        "lowest line: relative gap": np.where(
            both, np.log(np.where(both, lowest.gap_mm, 1.0) / shortest), 2.0
        ),
        "lowest line: log gap": np.where(both, np.log(np.where(both, lowest.gap_mm, 1.0) / cell_mm), 4.0),
        "lowest line: distance to the nearer rim": np.nan_to_num(lowest.nearer),
        "lowest line: below the shortest": _angle(beneath - lowest.upper_mm, shortest),
    }
    for side, low in zip(LOW_CELLS, neighbourhood.low_mm, strict=True):
        result |= {
            f"lowest within {side}": _ratio(low - base, scale),
            f"lowest within {side} below the floor": _angle(low - profiles.floor_mm, shortest),
            f"lowest within {side} below the shortest line": _angle(beneath - low, shortest),
        }
    return result


def _ratio(over: NDArray[np.float64], under: NDArray[np.float64]) -> NDArray[np.float64]:
    ratio = over / under
    return np.clip(np.where(np.isfinite(ratio), ratio, 0.0), -MOST_RATIO, MOST_RATIO)


def _angle(rise: NDArray[np.float64], run: NDArray[np.float64] | float) -> NDArray[np.float64]:
    slope = rise / run
    return np.arctan(np.where(np.isfinite(slope), slope, 0.0))
