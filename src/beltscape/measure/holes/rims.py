"""The rims of holes: the first measured cells on both sides of every hole cell, along lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.kernels import load
from beltscape.kernels.arrays import CellIndices
from beltscape.kernels.geometry.ray_march import FirstHits

_LOADED_MM = 5.0
"""Cells no higher than this are bare belt."""
_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Directions (rows, columns) along x, along y and both diagonals."""
_TURNS_DEG = (14, 31, 59, 76, 104, 121, 149, 166)
"""Directions between these, 14° to 17° apart; none of them runs along a border between cells."""
_LONGEST_CELLS = 95
"""Lines along slots end at this distance on either side."""


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A line through every hole cell, (H,) each, with its rims on the near side (-) and on the far side (+)."""

    near_mm: NDArray[np.float64]
    """Height of the rim; NaN where there is none."""
    far_mm: NDArray[np.float64]
    near_at_mm: NDArray[np.float64]
    """Distance to the rim; inf where there is none."""
    far_at_mm: NDArray[np.float64]
    near_slope: NDArray[np.float64]
    """Steepness of the surface at the rim, 0 level."""
    far_slope: NDArray[np.float64]
    near_rise: NDArray[np.float64]
    """Rise over run of the surface at the rim towards the far side."""
    far_rise: NDArray[np.float64]
    ray_slope: NDArray[np.float64]
    """Slope of the core's rays, positive where they descend towards the far side."""
    is_vertical: NDArray[np.bool_]
    """Whether the rays are vertical, so that the core's line of sight has no direction."""


@dataclass(frozen=True, slots=True, eq=False)
class StructureFunction:
    """The structure function of a surface: its roughness as a function of distance."""

    distance_mm: NDArray[np.float64]
    """(K,) distance between two points, ascending from 0."""
    rms_mm: NDArray[np.float64]
    """(K,) robust standard deviation of the midpoint's height over the straight line between the two points."""

    def roughness_mm(self, gap_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the roughness (N,) over gaps (N,)."""
        return np.interp(gap_mm, self.distance_mm, self.rms_mm)


@dataclass(frozen=True, slots=True, eq=False)
class LowestLine:
    """The line through each of H hole cells whose higher rim is lowest; inf and NaN where none has two rims."""

    upper_mm: NDArray[np.float64]
    lower_mm: NDArray[np.float64]
    gap_mm: NDArray[np.float64]
    """Distance from rim to rim."""
    nearer: NDArray[np.float64]
    """Distance to the nearer rim as a share of the gap, up to a half."""


def estimate_structure_function(value_mm: NDArray[np.float64], cell_mm: float) -> StructureFunction:
    """Estimate the structure function of a field (Ny, Nx) of loads, where there is load, at doubling distances."""
    apart, rms = [0.0], [0.0]
    loaded = np.where(value_mm > _LOADED_MM, value_mm, np.nan)
    half = 1
    while 2 * half < max(value_mm.shape):
        off: list[NDArray[np.float64]] = []
        down = np.s_[half:-half, 2 * half :, : -2 * half]
        for here, after, before in (down, [(slice(None), part) for part in down]):
            bend = np.abs(loaded[here] - 0.5 * (value_mm[after] + value_mm[before]))
            off.append(bend[np.isfinite(bend)])
        if len(values := np.concatenate(off)) < 200:
            break
        apart.append(2 * half * cell_mm)
        rms.append(max(rms[-1], MAD_TO_SIGMA * float(np.median(values, overwrite_input=True))))
        half *= 2
    return StructureFunction(np.array(apart), np.array(rms))


def fit_gradients(value_mm: NDArray[np.float64], cell_mm: float) -> NDArray[np.float64]:
    """Return the slopes (2, Ny, Nx) in x, y of planes fitted around each cell; 0 where too few were measured."""
    return load().plane_slopes(value_mm) / cell_mm


def find_lowest_line(
    lines: list[Line], rim_mm: NDArray[np.float64], cells: CellIndices, cell_mm: float
) -> LowestLine:
    """Return, of twelve lines through each hole cell, the one whose higher rim is lowest.

    In a slot between walls this line runs along the slot, at whose ends the floor may be visible. ``lines`` are those
    of `trace_lines`.
    """
    directions = np.deg2rad(np.array(_TURNS_DEG))[:, None] + np.array([np.pi, 0.0])  # both sides
    down, across = np.sin(directions).reshape(-1, 1), np.cos(directions).reshape(-1, 1)
    met = load().first_hits(np.isfinite(rim_mm), cells, down, across, _LONGEST_CELLS)
    at = met.cell.reshape(*directions.shape, -1)
    steps = met.steps.reshape(*directions.shape, -1)
    height = np.where(at >= 0, rim_mm.ravel()[at], np.nan)
    fixed = [np.stack([line.near_mm, line.far_mm, line.near_at_mm, line.far_at_mm]) for line in lines[1:]]
    turned = np.concatenate([height, steps * cell_mm], axis=1)
    near, far, near_at, far_at = np.concatenate([fixed, turned]).transpose(1, 0, 2)
    met = np.isfinite(near) & np.isfinite(far)
    upper = np.where(met, np.fmax(near, far), np.inf)
    gap = np.where(met, near_at + far_at, np.inf)
    nearer = np.where(met, np.minimum(near_at, far_at), np.nan) / np.where(met, gap, 1.0)
    lower = np.fmin(near, far)
    # rounding makes equal lengths equal, in any unit and any order of summation
    gap_cells = np.round(gap / cell_mm, 6)
    first = np.ones(upper.shape, bool)
    for key in (upper, gap_cells, lower, np.round(nearer, 9)):
        rest = np.where(first, key, np.inf)
        first &= rest == np.fmin.reduce(rest)
    own = np.argmax(first, axis=0)[None]
    selected = (np.take_along_axis(part, own, axis=0)[0] for part in (upper, lower, gap, nearer))
    return LowestLine(*selected)


def trace_lines(
    rim_mm: NDArray[np.float64],
    cells: CellIndices,
    gradient: NDArray[np.float64],
    ray_slopes: NDArray[np.float64],
    cell_mm: float,
) -> list[Line]:
    """Trace five lines through the hole ``cells`` of a field ``rim_mm`` (Ny, Nx) with NaN in its holes.

    The core's line of sight comes first (along ``ray_slopes`` (2, Ny, Nx)), then four fixed directions.
    """
    tan_x, tan_y = ray_slopes[0][cells], ray_slopes[1][cells]
    tangent = np.hypot(tan_x, tan_y)
    straight_down = tangent < 1e-9
    unit = np.where(straight_down, 1.0, tangent)
    down, across = np.where(straight_down, 0.0, tan_y / unit), np.where(straight_down, 1.0, tan_x / unit)

    def line(
        ends: FirstHits,
        step_mm: float,
        direction: tuple[NDArray[np.float64] | float, ...],
        ray_slope: NDArray[np.float64],
    ) -> Line:
        met = ends.cell >= 0
        height = np.where(met, rim_mm.ravel()[ends.cell], np.nan)
        x, y = (np.where(met, part.ravel()[ends.cell], 0.0) for part in gradient)
        rise = x * direction[1] + y * direction[0]
        ends_of_line = (height, ends.steps * step_mm, np.hypot(x, y), rise)
        pairs: list[NDArray[np.float64]] = [end for pair in ends_of_line for end in pair]
        return Line(*pairs, ray_slope=ray_slope, is_vertical=straight_down)

    measured, both = np.isfinite(rim_mm), np.array([-1.0, 1.0])[:, None]
    farthest = max(measured.shape) - 1
    own = load().first_hits(measured, cells, both * down, both * across, farthest)
    lines = [line(own, cell_mm, (down, across), tangent)]
    directions = (both[:, 0] * np.array(_DIRECTIONS)[..., None]).transpose(1, 0, 2).reshape(2, -1, 1)
    met = load().first_hits(measured, cells, directions[0], directions[1], farthest)
    for k, direction in enumerate(_DIRECTIONS):
        length = float(np.hypot(*direction))
        ray_slope = (tan_x * direction[1] + tan_y * direction[0]) / length
        ends = FirstHits(met.cell[2 * k : 2 * k + 2], met.steps[2 * k : 2 * k + 2])
        lines.append(line(ends, cell_mm * length, (direction[0] / length, direction[1] / length), ray_slope))
    return lines
