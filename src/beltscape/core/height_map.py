"""Height maps and cross-sections in the belt frame.

Belt frame: origin where the core camera's optical axis meets the empty belt; z up, normal to the flat centre;
x across, nearest to the core image's +u; y = z × x, along the belt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_list_or_tuple, require_array, require_like, require_number, show_value
from beltscape.core.errors import ArgumentError


@dataclass(frozen=True, slots=True, eq=False)
class HeightMap:
    """Heights above the belt's flat centre on a square grid in the belt frame; NaN = not measured."""

    height_mm: NDArray[np.float64]
    """(Ny, Nx) float64: row j is at y = origin_mm[1] + j·cell_mm, column i at x = origin_mm[0] + i·cell_mm."""
    sigma_mm: NDArray[np.float64]
    """(Ny, Nx) float64, one standard deviation of it."""
    origin_mm: tuple[float, float]
    """(x, y) of the centre of cell (0, 0)."""
    cell_mm: float
    """Edge of a cell."""

    def __post_init__(self) -> None:
        """Raise ArgumentError unless heights and sigmas are arrays of one shape, and the cells have a size."""
        require_array(self.height_mm, "height_mm", (None, None))
        require_like(self.sigma_mm, "sigma_mm", self.height_mm, "height_mm")
        require_number(self.cell_mm, "cell_mm", 0.0, above=True)
        if not is_list_or_tuple(self.origin_mm) or len(self.origin_mm) != 2:
            raise ArgumentError(f"origin_mm = {show_value(self.origin_mm)}: must be (x, y)")
        for value in self.origin_mm:
            require_number(value, "origin_mm")

    def __repr__(self) -> str:
        rows, columns = self.height_mm.shape
        low, high = (
            (np.nanmin(self.height_mm), np.nanmax(self.height_mm))
            if np.isfinite(self.height_mm).any()
            else (np.nan, np.nan)
        )
        return f"HeightMap({columns}×{rows} cells of {self.cell_mm:.2f} mm, {low:.1f} to {high:.1f} mm)"

    @property
    def x_mm(self) -> NDArray[np.float64]:
        """(Nx,) centres of the columns."""
        return self.origin_mm[0] + self.cell_mm * np.arange(int(self.height_mm.shape[1]), dtype=np.float64)

    @property
    def y_mm(self) -> NDArray[np.float64]:
        """(Ny,) centres of the rows."""
        return self.origin_mm[1] + self.cell_mm * np.arange(len(self.height_mm), dtype=np.float64)


def coarsen(
    heights: HeightMap, share: NDArray[np.float64], cell_mm: float
) -> tuple[HeightMap, NDArray[np.float64]]:
    """Return means of a height map, its σ, and the measured ``share`` (Ny, Nx) over blocks near an edge.

    Blocks begin at whole multiples of their edge along y, so that belts of different beginnings share them. A block
    is the mean of its cells with a height; without one it has none. σ is that of errors that neighbours share.
    """
    side = max(1, round(cell_mm / heights.cell_mm))
    if side == 1:
        return heights, share
    rows, columns = heights.height_mm.shape
    first = round(heights.origin_mm[1] / heights.cell_mm)
    before, across = first % side, columns // side
    size = -(-(before + rows) // side)
    known = np.zeros((size * side, across * side))
    known[before : before + rows] = np.isfinite(heights.height_mm[:, : across * side])

    def total(plane: NDArray[np.float64]) -> NDArray[np.float64]:
        padded = np.zeros(known.shape)
        padded[before : before + rows] = np.nan_to_num(plane[:, : across * side])
        return np.where(known > 0, padded, 0.0).reshape(size, side, across, side).sum(axis=(1, 3))

    number = known.reshape(size, side, across, side).sum(axis=(1, 3))
    with np.errstate(invalid="ignore"):
        height, sigma, part = (
            total(plane) / number for plane in (heights.height_mm, heights.sigma_mm, share)
        )
    middle = 0.5 * (side - 1) * heights.cell_mm
    start = heights.origin_mm[1] - before * heights.cell_mm
    coarse = HeightMap(height, sigma, (heights.origin_mm[0] + middle, start + middle), side * heights.cell_mm)
    return coarse, np.nan_to_num(part)


@dataclass(frozen=True, slots=True, eq=False)
class BeltProfile:
    """One cross-section of the load: its height over the empty belt along x."""

    y_mm: float
    """Position along the belt."""
    x_mm: NDArray[np.float64]
    """(Nx,) float64, across the belt."""
    height_mm: NDArray[np.float64]
    """(Nx,) float64, load above the empty belt."""
    area_mm2: float
    """Area of the load's cross-section."""
    coverage: float
    """Share of the cross-section that was measured, 0..1."""

    def __post_init__(self) -> None:
        """Raise ArgumentError unless there is a height for each x."""
        require_array(self.x_mm, "x_mm", (None,))
        require_like(self.height_mm, "height_mm", self.x_mm, "x_mm")

    def __repr__(self) -> str:
        return (
            f"BeltProfile(y {self.y_mm:.1f} mm, {self.area_mm2 / 100:.1f} cm², {self.coverage:.1%} measured)"
        )
