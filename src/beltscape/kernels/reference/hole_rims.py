"""The rims of holes: the first measured cells on both sides of every hole cell, along lines.

Rim profiles are the rims along five lines, and the smooth surface predicted between them: quadratic surfaces are
fitted to the measured cells around.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.kernels.arrays import CellIndices
from beltscape.kernels.holes import (
    DIRECTIONS,
    LEAST_BENDS,
    LOADED_MM,
    LONGEST_CELLS,
    OPEN,
    REACH_CELLS,
    SMOOTH,
    TINY_MM,
    TURNS_DEG,
    WINDOWS,
)
from beltscape.kernels.reference.windows import (
    FirstHits,
    collect_bends,
    find_first_hits,
    fit_plane_slopes,
    fit_quadratics,
)


@dataclass(frozen=True, slots=True, eq=False)
class RimLine:
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
    halves = [1 << k for k in range(max(value_mm.shape).bit_length()) if 2 << k < max(value_mm.shape)]
    for half in halves:
        bends = collect_bends(value_mm, half, LOADED_MM)
        if len(bends) < LEAST_BENDS:
            break
        apart.append(2 * half * cell_mm)
        rms.append(max(rms[-1], MAD_TO_SIGMA * float(np.median(bends))))
    return StructureFunction(np.array(apart), np.array(rms))


def fit_gradients(value_mm: NDArray[np.float64], cell_mm: float) -> NDArray[np.float64]:
    """Return the slopes (2, Ny, Nx) in x, y of planes fitted around each cell; 0 where too few were measured."""
    return fit_plane_slopes(value_mm) / cell_mm


def find_lowest_line(
    lines: list[RimLine], rim_mm: NDArray[np.float64], cells: CellIndices, cell_mm: float
) -> LowestLine:
    """Return, of twelve lines through each hole cell, the one whose higher rim is lowest.

    In a slot between walls this line runs along the slot, at whose ends the floor may be visible. ``lines`` are those
    of `trace_lines`.
    """
    directions = np.deg2rad(np.array(TURNS_DEG))[:, None] + np.array([np.pi, 0.0])  # both sides
    down, across = np.sin(directions).reshape(-1, 1), np.cos(directions).reshape(-1, 1)
    met = find_first_hits(np.isfinite(rim_mm), cells, down, across, LONGEST_CELLS)
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
) -> list[RimLine]:
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
    ) -> RimLine:
        met = ends.cell >= 0
        height = np.where(met, rim_mm.ravel()[ends.cell], np.nan)
        x, y = (np.where(met, part.ravel()[ends.cell], 0.0) for part in gradient)
        rise = x * direction[1] + y * direction[0]
        ends_of_line = (height, ends.steps * step_mm, np.sqrt(x * x + y * y), rise)
        pairs: list[NDArray[np.float64]] = [end for pair in ends_of_line for end in pair]
        return RimLine(*pairs, ray_slope=ray_slope, is_vertical=straight_down)

    measured, both = np.isfinite(rim_mm), np.array([-1.0, 1.0])[:, None]
    farthest = max(measured.shape) - 1
    own = find_first_hits(measured, cells, both * down, both * across, farthest)
    lines = [line(own, cell_mm, (down, across), tangent)]
    directions = (both[:, 0] * np.array(DIRECTIONS)[..., None]).transpose(1, 0, 2).reshape(2, -1, 1)
    met = find_first_hits(measured, cells, directions[0], directions[1], farthest)
    for k, direction in enumerate(DIRECTIONS):
        length = float(np.hypot(*direction))
        ray_slope = (tan_x * direction[1] + tan_y * direction[0]) / length
        ends = FirstHits(met.cell[2 * k : 2 * k + 2], met.steps[2 * k : 2 * k + 2])
        lines.append(line(ends, cell_mm * length, (direction[0] / length, direction[1] / length), ray_slope))
    return lines


@dataclass(frozen=True, slots=True, eq=False)
class Quadrics:
    """Least-squares quadratics in windows of K sizes around H cells, NaN where the window does not determine one."""

    value_mm: NDArray[np.float64]
    """(K, H) height at the window's centre."""
    rms_mm: NDArray[np.float64]
    """(K, H) root mean square residual of the measured cells of the window: 0 on a smooth surface."""
    leverage: NDArray[np.float64]
    """(K, H) variance of the value in units of one cell's over their number: 1 for a mean, large if extrapolated."""


def fit_quadrics(value_mm: NDArray[np.float64], cells: CellIndices, sides: tuple[int, ...]) -> Quadrics:
    """Fit the measured cells of a field (Ny, Nx) in windows of odd ``sides`` cells around cells (row, column)."""
    # relative to the field's mean, so that squares keep their precision
    middle = float(np.nanmean(value_mm))
    value, miss, leverage = fit_quadratics(value_mm - middle, cells, sides)
    return Quadrics(value + middle, miss, leverage)


@dataclass(frozen=True, slots=True, eq=False)
class RimProfiles:
    """Rims of H hole cells along five lines: the core's line of sight, then four others by ascending gap.

    Fields (5, H). Where a line has only one rim, the gap is inf, both heights are that rim's, the share is a half.
    """

    upper_mm: NDArray[np.float64]
    """Height of the higher rim."""
    lower_mm: NDArray[np.float64]
    """Height of the lower rim."""
    gap_mm: NDArray[np.float64]
    """Distance from rim to rim."""
    share: NDArray[np.float64]
    """Distance from the upper rim to the cell, as a share of the gap."""
    upper_slope: NDArray[np.float64]
    """Steepness of the surface at the upper rim."""
    lower_slope: NDArray[np.float64]
    """Steepness of the surface at the lower rim."""
    ray_slope: NDArray[np.float64]
    """Slope of the core's rays, positive where they descend away from the upper rim."""
    upper_rise: NDArray[np.float64]
    """Rise over run of the surface at the upper rim, into the hole."""
    lower_rise: NDArray[np.float64]
    """Rise over run of the surface at the lower rim, into the hole."""

    @property
    def has_both_rims(self) -> NDArray[np.bool_]:
        """Return (5, H) whether a line has a rim on both sides."""
        return np.isfinite(self.gap_mm)

    @property
    def is_between_rims(self) -> NDArray[np.bool_]:
        """Return (H,) whether any line has a rim on both sides."""
        return np.asarray(self.has_both_rims.any(axis=0), bool)

    @property
    def floor_mm(self) -> NDArray[np.float64]:
        """Return the height of the lowest rim (H,); NaN where there is none."""
        return np.fmin.reduce(self.lower_mm)

    @property
    def ceiling_mm(self) -> NDArray[np.float64]:
        """Return the height of the highest rim (H,); NaN where there is none."""
        return np.fmax.reduce(self.upper_mm)

    def shortest_mm(self, cell_mm: float) -> NDArray[np.float64]:
        """Return the shortest gap (H,); the size of a cell where no line has two rims."""
        return np.where(self.is_between_rims, self.gap_mm.min(axis=0), cell_mm)

    def tangents_mm(self) -> NDArray[np.float64]:
        """Return the tangents (2, 5, H) at the upper and the lower rim, evaluated at the cell; NaN for one rim."""
        gap = np.where(self.has_both_rims, self.gap_mm, np.nan)
        upper = self.upper_mm + self.upper_rise * self.share * gap
        return np.stack([upper, self.lower_mm + self.lower_rise * (1 - self.share) * gap])

    def straight_mm(self, cell_mm: float) -> NDArray[np.float64]:
        """Return the mean (H,) of linear interpolation along the lines, by 1/gap²; NaN where there are none."""
        weight = np.where(self.has_both_rims, 1 / np.maximum(self.gap_mm, cell_mm) ** 2, 0.0)
        line = np.where(self.has_both_rims, self.upper_mm - (self.upper_mm - self.lower_mm) * self.share, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return (weight * line).sum(axis=0) / weight.sum(axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothSurface:
    """The smooth surface predicted in H hole cells, and the range in which the true one may deviate from it."""

    base_mm: NDArray[np.float64]
    """(H,) the quadratic's height where the measured cells around follow it, else that of linear interpolation."""
    scale_mm: NDArray[np.float64]
    """(H,) range of deviation, from the height difference of the rims and the roughness, limited by the measured
    cells' deviation from a smooth surface; about 0 in a plane, a slope, a sphere."""
    smooth: NDArray[np.float64]
    """(H,) 0..1, weight of the quadratic in the base."""
    structure_mm: NDArray[np.float64]
    """(2, H) structure function of the measured surface over the shortest gap and over four times the gap."""


def compute_rim_profiles(lines: list[RimLine]) -> RimProfiles:
    """Return the rim profiles along five lines, the first of which is the core's line of sight."""
    rims = np.stack([_order_rims(line) for line in lines])
    # equal gaps are ordered by heights, then by slopes, so that a mirrored field is filled mirrored
    upper, lower, gap, share, *slopes = rims[1:].transpose(1, 0, 2)
    order = np.lexsort((slopes[1], slopes[0], share, -upper, -lower, gap), axis=0) + 1
    others = np.take_along_axis(rims, order[:, None, :], axis=0)
    # vertical rays define no line: the shortest line replaces it
    own = cast("NDArray[np.float64]", np.where(lines[0].is_vertical, others[0], rims[0]))
    return RimProfiles(*np.concatenate([own[None], others]).transpose(1, 0, 2))


def _order_rims(line: RimLine) -> NDArray[np.float64]:
    """Return the fields of `RimProfiles` for one line (9, H)."""
    near, far = line.near_mm, line.far_mm
    both = np.isfinite(near) & np.isfinite(far)
    # of equal heights the nearer rim, then the steeper one, so that a mirrored field is filled mirrored
    ties = [(far, near), (line.near_at_mm, line.far_at_mm), (line.far_slope, line.near_slope)]
    swapped, level = ~np.isfinite(near), both.copy()
    for one, two in ties:
        swapped |= level & (one > two)
        level &= one == two
    gap = np.where(both, line.near_at_mm + line.far_at_mm, np.inf)
    from_upper = np.where(swapped, line.far_at_mm, line.near_at_mm)
    return np.stack(
        [
            np.fmax(near, far),
            np.fmin(near, far),
            gap,
            np.where(both, from_upper, 0.5) / np.where(both, gap, 1.0),
            np.where(swapped, line.far_slope, line.near_slope),
            np.where(swapped, line.near_slope, line.far_slope),
            np.where(swapped, -line.ray_slope, line.ray_slope),
            np.where(swapped, -line.far_rise, line.near_rise),
            np.where(swapped, line.near_rise, -line.far_rise),
        ]
    )


def predict_smooth_surface(
    profiles: RimProfiles, quadric_fits: Quadrics, structure: StructureFunction, cell_mm: float
) -> SmoothSurface:
    """Predict the smooth surface; ``base_mm`` is NaN where no line has rims on both sides.

    The base uses the smallest window that spans the shortest gap and determines a quadratic; the range of deviation
    also uses the next larger one.
    """
    straight, shortest = profiles.straight_mm(cell_mm), profiles.shortest_mm(cell_mm)
    determined = np.isfinite(quadric_fits.value_mm)
    too_narrow = np.array(WINDOWS[:-1])[:, None] < 2 * shortest / cell_mm + REACH_CELLS
    reaching = np.arange(len(WINDOWS))[:, None] >= too_narrow.sum(axis=0)
    own = np.argmax(determined & reaching, axis=0)
    has = (determined & reaching).any(axis=0)
    value, rms = (
        np.take_along_axis(part, own[None], axis=0)[0]
        for part in (quadric_fits.value_mm, quadric_fits.rms_mm)
    )
    rms = np.where(has, rms, 0.0)
    tangents = profiles.tangents_mm()
    ceiling, floor = profiles.ceiling_mm, profiles.floor_mm
    # a smooth surface lies between its rims and the tangents at the rims
    high = np.fmax(ceiling, np.fmax.reduce(tangents, axis=(0, 1)))
    low = np.fmin(floor, np.fmin.reduce(tangents, axis=(0, 1)))
    bend = np.where(has, np.clip(value, low, high) - straight, 0.0)
    share = np.where(has, bend**2 / (bend**2 + (2 * rms) ** 2 + TINY_MM**2), 0.0)
    near = np.arange(len(WINDOWS))[:, None] <= own + 1
    rms_values = np.where(determined & reaching & near, quadric_fits.rms_mm, 0.0)
    max_rms = rms_values.max(axis=0)
    half_mm = 0.5 * cell_mm * np.array(WINDOWS)[:, None]
    rough_share = np.minimum((rms_values / half_mm).max(axis=0) / SMOOTH, 1.0) ** 2
    roughness = np.stack([structure.roughness_mm(shortest), structure.roughness_mm(4 * shortest)])
    scale = np.sqrt((ceiling - floor) ** 2 + (2 * rms) ** 2 + roughness[0] ** 2)
    scale: NDArray[np.float64] = np.where(has, np.minimum(scale, OPEN * max_rms) * rough_share, scale)
    return SmoothSurface(straight + share * bend, scale + TINY_MM, share, roughness)
