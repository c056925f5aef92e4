"""Depth map → heights on a grid in the belt frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt import HeightMap
from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.core.pose import Pose

_QUANTUM_MM = 1e-6
"""Heights are sorted as integers of this step: far below any noise."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Square cells in the belt frame."""

    origin_mm: tuple[float, float]
    """(x, y) of the centre of cell (0, 0)."""
    cell_mm: float
    """Edge of a cell."""
    shape: tuple[int, int]
    """(Ny, Nx)."""

    @property
    def x_mm(self) -> NDArray[np.float64]:
        """(Nx,) centres of the columns."""
        return self.origin_mm[0] + self.cell_mm * np.arange(self.shape[1], dtype=np.float64)

    @property
    def y_mm(self) -> NDArray[np.float64]:
        """(Ny,) centres of the rows."""
        return self.origin_mm[1] + self.cell_mm * np.arange(self.shape[0], dtype=np.float64)

    @classmethod
    def over(cls, across_mm: tuple[float, float], along_mm: tuple[float, float], cell_mm: float) -> Grid:
        """Smallest grid whose cells' centres enclose a box."""
        columns = int(np.ceil((across_mm[1] - across_mm[0]) / cell_mm)) + 1
        rows = int(np.ceil((along_mm[1] - along_mm[0]) / cell_mm)) + 1
        return cls((across_mm[0], along_mm[0]), cell_mm, (rows, columns))


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Heights on a grid, with the two parts of their uncertainty apart."""

    heights: HeightMap
    """Median height per cell and its whole σ; NaN where a cell got no point."""
    noise_mm: NDArray[np.float64]
    """(Ny, Nx) the part of σ that neighbouring cells share: the depth map's own."""
    points: NDArray[np.int64]
    """(Ny, Nx) number of points in the cell."""


def pixel_size_mm(depth: DepthMap, camera: Camera) -> float:
    """Edge of a pixel on a surface square to the axis at the median depth."""
    return float(np.nanmedian(depth.depth_mm)) / float(camera.focal_px.mean())


def trusted(depth: DepthMap, limit_mm: float) -> NDArray[np.bool_]:
    """(H, W) pixels whose σ is small beside the scale one resolves: at most ``limit_mm`` or five typical σ."""
    sigma = np.where(depth.measured, depth.sigma_mm, np.nan)
    typical = float(np.nanmedian(sigma)) if np.isfinite(sigma).any() else 0.0
    return depth.measured & (sigma <= max(limit_mm, 5 * typical))


def height_map(
    depth: DepthMap, camera: Camera, belt_from_core: Pose, grid: Grid, use: NDArray[np.bool_]
) -> Surface:
    """Median height of the points in each cell, from the pixels ``use`` (H, W).

    The median resists flying pixels. A cell's σ joins the points' mean σ (neighbours err together: it does not
    fall with their number) and the median's own scatter, from the quartiles of the heights.
    """
    points = np.concatenate([camera.rays()[use], np.ones((int(use.sum()), 1))], axis=1)
    points *= depth.depth_mm[use].astype(np.float64)[:, None]
    points = belt_from_core.apply(points)
    column = np.rint((points[:, 0] - grid.origin_mm[0]) / grid.cell_mm).astype(np.int64)
    row = np.rint((points[:, 1] - grid.origin_mm[1]) / grid.cell_mm).astype(np.int64)
    rows, columns = grid.shape
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    cell = (row * columns + column)[inside]
    height, scatter, count = _medians(cell, points[inside, 2], rows * columns)
    variance = np.bincount(cell, depth.sigma_mm[use][inside].astype(np.float64) ** 2, rows * columns)
    with np.errstate(invalid="ignore", divide="ignore"):
        noise = np.sqrt(variance / count)
        sigma = np.sqrt(variance / count + (1.25 * scatter) ** 2 / count)
    height, sigma, noise, count = (part.reshape(grid.shape) for part in (height, sigma, noise, count))
    return Surface(HeightMap(height, sigma, grid.origin_mm, grid.cell_mm), noise, count)


def _medians(
    cell: NDArray[np.int64], height_mm: NDArray[np.float64], cells: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Median, robust scatter (from quartiles) and number of the heights in each cell."""
    # one integer per point, cell above height: a plain sort groups and ranks at once
    level = np.rint(height_mm / _QUANTUM_MM).astype(np.int64) + (1 << 35)
    key = np.sort((cell << 36) | np.clip(level, 0, (1 << 36) - 1))
    level = (key & ((1 << 36) - 1)) - (1 << 35)
    count = np.bincount(cell, minlength=cells)
    first = np.cumsum(count) - count
    full = count > 0
    start, number = first[full], count[full]

    def ranked(rank: NDArray[np.int64]) -> NDArray[np.float64]:
        return level[start + rank].astype(np.float64) * _QUANTUM_MM

    median, scatter = np.full(cells, np.nan), np.full(cells, np.nan)
    median[full] = 0.5 * (ranked((number - 1) // 2) + ranked(number // 2))
    scatter[full] = (ranked((3 * (number - 1) + 2) // 4) - ranked((number - 1) // 4)) / 1.349
    return median, scatter, count
