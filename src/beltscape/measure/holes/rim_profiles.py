"""Rim profiles of hole cells: the rims along five lines, and the smooth surface predicted between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.holes.quadrics import Quadrics
from beltscape.measure.holes.rims import Line, StructureFunction

WINDOWS = (9, 25, 51, 101)
"""Cells across the windows in which quadratics are fitted."""
_REACH_CELLS = 5
"""A window extends this far beyond the shortest gap."""
_OPEN = 4.0
"""Heights in a hole may deviate from the smooth surface by this multiple of the deviation of measured cells."""
_SMOOTH = 0.03
"""A surface is smooth, gradually, where it deviates from a quadratic by less than this share of half the window."""
_TINY_MM = 1e-6
"""Added so that an exactly flat surface does not divide by zero."""


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


def compute_rim_profiles(lines: list[Line]) -> RimProfiles:
    """Return the rim profiles along five lines, the first of which is the core's line of sight."""
    rims = np.stack([_order_rims(line) for line in lines])
    # equal gaps are ordered by heights, then by slopes, so that a mirrored field is filled mirrored
    upper, lower, gap, share, *slopes = rims[1:].transpose(1, 0, 2)
    order = np.lexsort((slopes[1], slopes[0], share, -upper, -lower, gap), axis=0) + 1
    others = np.take_along_axis(rims, order[:, None, :], axis=0)
    # vertical rays define no line: the shortest line replaces it
    own = cast("NDArray[np.float64]", np.where(lines[0].is_vertical, others[0], rims[0]))
    return RimProfiles(*np.concatenate([own[None], others]).transpose(1, 0, 2))


def _order_rims(line: Line) -> NDArray[np.float64]:
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
    too_narrow = np.array(WINDOWS[:-1])[:, None] < 2 * shortest / cell_mm + _REACH_CELLS
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
    share = np.where(has, bend**2 / (bend**2 + (2 * rms) ** 2 + _TINY_MM**2), 0.0)
    near = np.arange(len(WINDOWS))[:, None] <= own + 1
    rms_values = np.where(determined & reaching & near, quadric_fits.rms_mm, 0.0)
    max_rms = rms_values.max(axis=0)
    half_mm = 0.5 * cell_mm * np.array(WINDOWS)[:, None]
    rough_share = np.minimum((rms_values / half_mm).max(axis=0) / _SMOOTH, 1.0) ** 2
    roughness = np.stack([structure.roughness_mm(shortest), structure.roughness_mm(4 * shortest)])
    scale = np.sqrt((ceiling - floor) ** 2 + (2 * rms) ** 2 + roughness[0] ** 2)
    scale: NDArray[np.float64] = np.where(has, np.minimum(scale, _OPEN * max_rms) * rough_share, scale)
    return SmoothSurface(straight + share * bend, scale + _TINY_MM, share, roughness)
