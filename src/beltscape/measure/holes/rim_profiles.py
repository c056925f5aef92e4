"""What a hole's cells see of its rims, and how a smooth surface would go on there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.holes.quadrics import Quadrics
from beltscape.measure.holes.rims import Hollows, Line

WINDOWS = (9, 25, 51, 101)
"""Cells across the windows in which quadratics are fitted."""
_REACH_CELLS = 5
"""A window reaches this far beyond the shortest gap."""
_OPEN = 4.0
"""What lies in a hole may miss the smooth surface by so many times what the cells measured about it do."""
_SMOOTH = 0.03
"""What misses a quadratic by less than this share of the window's half counts as smooth, the less the more so."""
_TINY_MM = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """What five lines tell of H hole cells: the camera's own, then the other four by the length of their gaps.

    Fields (5, H); where a line met only one rim, gap is inf, heights are that rim's, shares a half.
    """

    upper_mm: NDArray[np.float64]
    """Higher rim."""
    lower_mm: NDArray[np.float64]
    """Lower rim."""
    gap_mm: NDArray[np.float64]
    """From rim to rim."""
    share: NDArray[np.float64]
    """Of the gap, from the upper rim to the cell."""
    upper_slope: NDArray[np.float64]
    """Steepness of the surface at the upper rim."""
    lower_slope: NDArray[np.float64]
    """At the lower rim."""
    away: NDArray[np.float64]
    """Tangent by which the camera's rays come down away from the upper rim."""
    upper_rise: NDArray[np.float64]
    """Rise over run of the surface at the upper rim, into the hole."""
    lower_rise: NDArray[np.float64]
    """At the lower rim, into the hole."""

    @property
    def met(self) -> NDArray[np.bool_]:
        """(5, H) lines between two rims."""
        return np.isfinite(self.gap_mm)

    @property
    def between(self) -> NDArray[np.bool_]:
        """(H,) whether any line meets rims on both sides."""
        return np.asarray(self.met.any(axis=0), bool)

    @property
    def floor_mm(self) -> NDArray[np.float64]:
        """(H,) the lowest rim; NaN where none was met."""
        return np.fmin.reduce(self.lower_mm)

    @property
    def ceiling_mm(self) -> NDArray[np.float64]:
        """(H,) the highest rim."""
        return np.fmax.reduce(self.upper_mm)

    def shortest_mm(self, cell_mm: float) -> NDArray[np.float64]:
        """(H,) gap of the shortest line, a cell where no line meets two rims."""
        return np.where(self.between, self.gap_mm.min(axis=0), cell_mm)

    def tangents_mm(self) -> NDArray[np.float64]:
        """(2, 5, H) the surface continued straight to the cell from the upper and the lower rim; NaN for none."""
        gap = np.where(self.met, self.gap_mm, np.nan)
        upper = self.upper_mm + self.upper_rise * self.share * gap
        return np.stack([upper, self.lower_mm + self.lower_rise * (1 - self.share) * gap])

    def straight_mm(self, cell_mm: float) -> NDArray[np.float64]:
        """(H,) mean of the straight lines from rim to rim, short ones counting more; NaN where there are none."""
        weight = np.where(self.met, 1 / np.maximum(self.gap_mm, cell_mm) ** 2, 0.0)
        line = np.where(self.met, self.upper_mm - (self.upper_mm - self.lower_mm) * self.share, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return (weight * line).sum(axis=0) / weight.sum(axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """What a smooth surface would have in H hole cells, and how far from it the real one may be."""

    base_mm: NDArray[np.float64]
    """(H,) the quadratic's height where the measured cells about follow it, else that of the straight lines."""
    scale_mm: NDArray[np.float64]
    """(H,) how much is open: rims that differ and unevenness, and no more than the measured cells' own departure
    from a smooth surface allows; about 0 in a plane, a slope, a sphere."""
    smooth: NDArray[np.float64]
    """(H,) 0..1, how much the base is the quadratic's."""
    hollow_mm: NDArray[np.float64]
    """(2, H) unevenness of the measured surface over the shortest gap and over four times as much."""


def outlook(lines: list[Line]) -> Outlook:
    """The outlook along five lines, the first being the camera's own."""
    seen = np.stack([_upper_first(line) for line in lines])
    # where gaps are equal by heights, then by slopes: so a mirrored field is filled mirrored
    upper, lower, gap, share, *slopes = seen[1:].transpose(1, 0, 2)
    order = np.lexsort((slopes[1], slopes[0], share, -upper, -lower, gap), axis=0) + 1
    others = np.take_along_axis(seen, order[:, None, :], axis=0)
    # rays straight from above lie along no line: the shortest stands for them
    own = np.where(lines[0].upright, others[0], seen[0])
    return Outlook(*np.concatenate([own[None], others]).transpose(1, 0, 2))


def _upper_first(line: Line) -> NDArray[np.float64]:
    """(9, H) in the order of `Outlook`."""
    near, far = line.near_mm, line.far_mm
    both = np.isfinite(near) & np.isfinite(far)
    # where heights are equal the nearer rim, then the steeper: so a mirrored field is filled mirrored
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
            np.where(swapped, -line.slant, line.slant),
            np.where(swapped, -line.far_rise, line.near_rise),
            np.where(swapped, line.near_rise, -line.far_rise),
        ]
    )


def expected(look: Outlook, smooth: Quadrics, hollow: Hollows, cell_mm: float) -> Expected:
    """What is to be expected; NaN in ``base_mm`` where no line meets rims on both sides.

    Of the windows the smallest counts that reaches over the shortest gap and carries a quadratic, and for how much is
    open the next larger one.
    """
    straight, shortest = look.straight_mm(cell_mm), look.shortest_mm(cell_mm)
    sound = np.isfinite(smooth.value_mm)
    wide = np.array(WINDOWS[:-1])[:, None] < 2 * shortest / cell_mm + _REACH_CELLS
    reaching = np.arange(len(WINDOWS))[:, None] >= wide.sum(axis=0)
    own = np.argmax(sound & reaching, axis=0)
    has = (sound & reaching).any(axis=0)
    value, miss = (
        np.take_along_axis(part, own[None], axis=0)[0] for part in (smooth.value_mm, smooth.miss_mm)
    )
    miss = np.where(has, miss, 0.0)
    tangents = look.tangents_mm()
    ceiling, floor = look.ceiling_mm, look.floor_mm
    # a smooth surface lies between its rims and its tangents there
    high = np.fmax(ceiling, np.fmax.reduce(tangents.reshape(-1, len(ceiling))))
    low = np.fmin(floor, np.fmin.reduce(tangents.reshape(-1, len(floor))))
    bend = np.where(has, np.clip(value, low, high) - straight, 0.0)
    share = np.where(has, bend**2 / (bend**2 + (2 * miss) ** 2 + _TINY_MM**2), 0.0)
    near = np.arange(len(WINDOWS))[:, None] <= own + 1
    misses = np.where(sound & reaching & near, smooth.miss_mm, 0.0)
    most = misses.max(axis=0)
    half_mm = 0.5 * cell_mm * np.array(WINDOWS)[:, None]
    uneven_share = np.minimum((misses / half_mm).max(axis=0) / _SMOOTH, 1.0) ** 2
    uneven = np.stack([hollow.depth_mm(shortest), hollow.depth_mm(4 * shortest)])
    scale = np.sqrt((ceiling - floor) ** 2 + (2 * miss) ** 2 + uneven[0] ** 2)
    scale = np.where(has, np.minimum(scale, _OPEN * most) * uneven_share, scale)
    return Expected(straight + share * bend, scale + _TINY_MM, share, uneven)
