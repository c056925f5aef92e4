"""The measured rectangle of the belt (box), and integrals over it that count partial cells exactly."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt.height_map import BeltProfile
from beltscape.core.errors import InputError, MeasureError
from beltscape.core.quantities import BOX_SIDE
from beltscape.measure.surface import Grid

Range = tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class IntegrationWeights:
    """Integration weights of a grid's columns and rows: their outer product sums to the box's area."""

    across: NDArray[np.float64]
    """(Nx,) mm."""
    along: NDArray[np.float64]
    """(Ny,) mm."""

    def share(self, flags: NDArray[np.bool_]) -> float:
        """Return the share of the box's area where the flags (Ny, Nx) are set."""
        return float(self.along @ flags @ self.across / (self.along.sum() * self.across.sum()))


@dataclass(frozen=True, slots=True)
class Box:
    """Rectangle in the belt frame."""

    across_mm: Range
    """In x."""
    along_mm: Range
    """In y."""

    def integration_weights(self, grid: Grid) -> IntegrationWeights:
        """Return the weights of the grid's cells, exact for a surface that is linear between their centres."""
        return IntegrationWeights(
            _hat_integrals(grid.x_mm, grid.cell_mm, self.across_mm),
            _hat_integrals(grid.y_mm, grid.cell_mm, self.along_mm),
        )

    def enclose(self, across_mm: Range | None, along_mm: Range | None) -> Box:
        """Return the smallest box around this one and a requested one, refusing one that reaches too far outside."""
        return Box(
            _join_ranges("across", self.across_mm, across_mm or self.across_mm),
            _join_ranges("along", self.along_mm, along_mm or self.along_mm),
        )


def require_box_side(side: str, ends_mm: Range | None) -> None:
    """Raise InputError if a side of a requested box is too short to be in mm; None: it is not given."""
    if ends_mm is None:
        return
    low, high = ends_mm
    if high - low < BOX_SIDE.possible[0]:
        raise InputError(
            f"--{side} {low:g} {high:g}: {high - low:g} mm is no box on a belt ({BOX_SIDE.possible[0]:g} mm and more)"
            f"; in metres? write {1000 * low:g} {1000 * high:g}"
        )


def select_box(
    measured: NDArray[np.bool_], grid: Grid, across_mm: Range | None, along_mm: Range | None
) -> Box:
    """Return the given box; a side that is None becomes the range that is well measured.

    Raises
    ------
    MeasureError
        if nothing was measured in the box.
    """
    middle = slice(grid.shape[0] // 4, grid.shape[0] - grid.shape[0] // 4)
    if across_mm is None:
        across_mm = _find_measured_range(measured[middle].mean(axis=0), grid.x_mm)
    columns = (grid.x_mm >= across_mm[0]) & (grid.x_mm <= across_mm[1])
    if along_mm is None:
        along_mm = _find_measured_range(measured[:, columns].mean(axis=1), grid.y_mm)
    box = Box(across_mm, along_mm)
    if box.integration_weights(grid).share(measured) == 0:
        rows, columns = np.nonzero(measured)
        x, y = grid.x_mm[columns], grid.y_mm[rows]
        extent = (
            f"x {x.min():.0f} to {x.max():.0f} mm and y {y.min():.0f} to {y.max():.0f} mm"
            if len(x)
            else "nowhere"
        )
        raise MeasureError(
            f"box x {across_mm[0]:g} to {across_mm[1]:g} mm, y {along_mm[0]:g} to {along_mm[1]:g} mm: nothing was "
            f"measured in it; both surfaces were measured in {extent}"
        )
    return box


def compute_profiles(
    height_mm: NDArray[np.float64], measured: NDArray[np.bool_], grid: Grid, box: Box, every_mm: float
) -> list[BeltProfile]:
    """Return the mean cross-sections of equal stretches, no longer than ``every_mm``, that tile the box."""
    number = max(1, int(np.ceil((box.along_mm[1] - box.along_mm[0]) / every_mm - 1e-9)))
    ends = np.linspace(*box.along_mm, number + 1)
    result: list[BeltProfile] = []
    for start, end in pairwise(ends):
        weights = Box(box.across_mm, (float(start), float(end))).integration_weights(grid)
        own = weights.across > 0
        height = weights.along @ height_mm / weights.along.sum()
        area = float(weights.across @ height)
        middle = float(start + end) / 2
        result.append(BeltProfile(middle, grid.x_mm[own], height[own], area, weights.share(measured)))
    return result


def _hat_integrals(nodes: NDArray[np.float64], spacing: float, limits: Range) -> NDArray[np.float64]:
    """Return the integral of every node's hat function over the limits."""

    def up_to(limit: float) -> NDArray[np.float64]:
        s = np.clip((limit - nodes) / spacing, -1, 1)
        return spacing * np.where(s < 0, 0.5 * (1 + s) ** 2, 1 - 0.5 * (1 - s) ** 2)

    return up_to(limits[1]) - up_to(limits[0])


def _join_ranges(side: str, extent: Range, requested: Range) -> Range:
    low, high = requested
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(f"--{side} {low:g} {high:g}: give the lower end first, both in mm of the belt frame")
    require_box_side(side, requested)
    if high <= extent[0] or low >= extent[1]:
        raise MeasureError(
            f"--{side} {low:g} {high:g}: nothing was measured there; the belt was seen from "
            f"{extent[0]:.0f} to {extent[1]:.0f} mm"
        )
    size = extent[1] - extent[0]
    if low < extent[0] - size or high > extent[1] + size:
        raise InputError(
            f"--{side} {low:g} {high:g}: far larger than what was seen, {extent[0]:.0f} to {extent[1]:.0f} mm; "
            "give a box within it"
        )
    return min(low, extent[0]), max(high, extent[1])


def _find_measured_range(share: NDArray[np.float64], centers_mm: NDArray[np.float64]) -> Range:
    """Return the range from the first to the last row (or column) that is measured nearly as well as the best."""
    width = max(1, len(share) // 40)
    smoothed = np.convolve(np.pad(share, width, mode="edge"), np.ones(width) / width, "same")[
        width : width + len(share)
    ]
    on = np.flatnonzero((smoothed >= 0.75 * np.quantile(smoothed, 0.9)) & (smoothed > 0))
    if len(on) < 2:
        return float(centers_mm[0]), float(centers_mm[-1])
    return float(centers_mm[on[0]]), float(centers_mm[on[-1]])
