"""The stretch of belt that is measured, and sums over it that count partial cells exactly."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt import BeltProfile
from beltscape.core.errors import InputError, MeasureError
from beltscape.measure.surface import Grid

Range = tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Integration weights of a grid's columns and rows: their outer product sums to the box's area."""

    across: NDArray[np.float64]
    """(Nx,) mm."""
    along: NDArray[np.float64]
    """(Ny,) mm."""

    def share(self, flags: NDArray[np.bool_]) -> float:
        """Share of the box's area under the flags (Ny, Nx)."""
        return float(self.along @ flags @ self.across / (self.along.sum() * self.across.sum()))


@dataclass(frozen=True, slots=True)
class Box:
    """Rectangle in the belt frame."""

    across_mm: Range
    """In x."""
    along_mm: Range
    """In y."""

    def weights_mm(self, grid: Grid) -> Weights:
        """Weights of the grid's cells, exact for a surface that is linear between their centres."""
        return Weights(
            _hat_integrals(grid.x_mm, grid.cell_mm, self.across_mm),
            _hat_integrals(grid.y_mm, grid.cell_mm, self.along_mm),
        )

    def joined(self, across_mm: Range | None, along_mm: Range | None) -> Box:
        """Smallest box about this one and a wanted one, which may reach outside it by no more than its size."""
        return Box(
            _joined("across", self.across_mm, across_mm or self.across_mm),
            _joined("along", self.along_mm, along_mm or self.along_mm),
        )


def chosen_box(
    measured: NDArray[np.bool_], grid: Grid, across_mm: Range | None, along_mm: Range | None
) -> Box:
    """The box given, or where a side is not given the range that is well measured.

    Raises
    ------
    MeasureError
        if nothing was measured in the box.
    """
    middle = slice(grid.shape[0] // 4, grid.shape[0] - grid.shape[0] // 4)
    if across_mm is None:
        across_mm = _well_measured(measured[middle].mean(axis=0), grid.x_mm)
    columns = (grid.x_mm >= across_mm[0]) & (grid.x_mm <= across_mm[1])
    if along_mm is None:
        along_mm = _well_measured(measured[:, columns].mean(axis=1), grid.y_mm)
    box = Box(across_mm, along_mm)
    if box.weights_mm(grid).share(measured) == 0:
        rows, columns = np.nonzero(measured)
        x, y = grid.x_mm[columns], grid.y_mm[rows]
        seen = (
            f"x {x.min():.0f} to {x.max():.0f} mm and y {y.min():.0f} to {y.max():.0f} mm"
            if len(x)
            else "nowhere"
        )
        raise MeasureError(
            f"box x {across_mm[0]:g} to {across_mm[1]:g} mm, y {along_mm[0]:g} to {along_mm[1]:g} mm: nothing was "
            f"measured in it; both surfaces were measured in {seen}"
        )
    return box


def profiles(
    height_mm: NDArray[np.float64], measured: NDArray[np.bool_], grid: Grid, box: Box, every_mm: float
) -> list[BeltProfile]:
    """Mean cross-sections of equal stretches, no longer than ``every_mm``, that tile the box."""
    number = max(1, int(np.ceil((box.along_mm[1] - box.along_mm[0]) / every_mm - 1e-9)))
    ends = np.linspace(*box.along_mm, number + 1)
    found = []
    for start, end in pairwise(ends):
        weights = Box(box.across_mm, (float(start), float(end))).weights_mm(grid)
        own = weights.across > 0
        height = weights.along @ height_mm / weights.along.sum()
        area = float(weights.across @ height)
        middle = float(start + end) / 2
        found.append(BeltProfile(middle, grid.x_mm[own], height[own], area, weights.share(measured)))
    return found


def _hat_integrals(nodes: NDArray[np.float64], spacing: float, limits: Range) -> NDArray[np.float64]:
    """Integral of every node's hat function over the limits."""

    def up_to(limit: float) -> NDArray[np.float64]:
        s = np.clip((limit - nodes) / spacing, -1, 1)
        return spacing * np.where(s < 0, 0.5 * (1 + s) ** 2, 1 - 0.5 * (1 - s) ** 2)

    return up_to(limits[1]) - up_to(limits[0])


def _joined(side: str, seen: Range, wanted: Range) -> Range:
    low, high = wanted
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(f"--{side} {low:g} {high:g}: give the lower end first, both in mm of the belt frame")
    if high <= seen[0] or low >= seen[1]:
        raise MeasureError(
            f"--{side} {low:g} {high:g}: nothing was measured there; the belt was seen from "
            f"{seen[0]:.0f} to {seen[1]:.0f} mm"
        )
    size = seen[1] - seen[0]
    if low < seen[0] - size or high > seen[1] + size:
        raise InputError(
            f"--{side} {low:g} {high:g}: far larger than what was seen, {seen[0]:.0f} to {seen[1]:.0f} mm; "
            "give a box within it"
        )
    return min(low, seen[0]), max(high, seen[1])


def _well_measured(share: NDArray[np.float64], centers_mm: NDArray[np.float64]) -> Range:
    """From the first to the last of the rows (or columns) that are measured nearly as well as the best."""
    width = max(1, len(share) // 40)
    calm = np.convolve(np.pad(share, width, mode="edge"), np.ones(width) / width, "same")[
        width : width + len(share)
    ]
    on = np.flatnonzero((calm >= 0.75 * np.quantile(calm, 0.9)) & (calm > 0))
    if len(on) < 2:
        return float(centers_mm[0]), float(centers_mm[-1])
    return float(centers_mm[on[0]]), float(centers_mm[on[-1]])
