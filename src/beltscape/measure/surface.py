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
_GRAZING = float(np.tan(np.deg2rad(10.0)))


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


def blocks_mean(values: NDArray[np.generic], side: int) -> NDArray[np.float64]:
    """Means (Ny // side, Nx // side) over square blocks of cells; a rest at the far ends is left out."""
    rows, columns = values.shape[0] // side, values.shape[1] // side
    blocks = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return blocks.astype(np.float64).mean(axis=(1, 3))


def pixel_size_mm(depth: DepthMap, camera: Camera) -> float:
    """Edge of a pixel on a surface square to the axis at the median depth."""
    return float(np.nanmedian(depth.depth_mm)) / float(camera.focal_px.mean())


def visible_step_mm(depth: DepthMap, camera: Camera) -> float:
    """Largest depth step between neighbouring pixels on one surface: seen under 10°, which no matcher measures."""
    noise = float(np.median(depth.sigma_mm[depth.measured])) if depth.measured.any() else 0.0
    return pixel_size_mm(depth, camera) / _GRAZING + 6 * noise


def height_map(
    depth: DepthMap, camera: Camera, belt_from_core: Pose, grid: Grid, use: NDArray[np.bool_]
) -> Surface:
    """Median height of the upper layer of points in each cell, from the pixels ``use`` (H, W).

    Where a gap parts a cell's points in height, the camera looked under an overhang, which counts as solid: only
    the upper ones count. A cell's σ joins the points' mean σ (neighbours err together: it does not fall with
    their number) and the median's own scatter, from the quartiles of the heights.
    """
    points = np.concatenate([camera.rays()[use], np.ones((int(use.sum()), 1))], axis=1)
    points *= depth.depth_mm[use].astype(np.float64)[:, None]
    points = belt_from_core.apply(points)
    place = (points[:, :2] - grid.origin_mm) / grid.cell_mm
    nearest = np.rint(place)
    rows, columns = grid.shape
    inside = ((nearest >= 0) & (nearest < (columns, rows))).all(axis=1)
    whole = nearest[inside].astype(np.int64)
    cell = whole[:, 1] * columns + whole[:, 0]
    height, scatter, count = _medians(cell, points[inside, 2], rows * columns, visible_step_mm(depth, camera))
    number = np.bincount(cell, minlength=rows * columns)

    def mean(values: NDArray[np.floating]) -> NDArray[np.float64]:
        return (np.bincount(cell, values, rows * columns) / number).reshape(grid.shape)

    with np.errstate(invalid="ignore", divide="ignore"):
        off = place[inside] - whole
        height = _centered(height.reshape(grid.shape), mean(off[:, 0]), mean(off[:, 1]))
        variance = mean(depth.sigma_mm[use][inside].astype(np.float64) ** 2)
        sampling = ((1.25 * scatter) ** 2 / count).reshape(grid.shape)
    sigma = np.sqrt(variance + sampling)
    return Surface(HeightMap(height, sigma, grid.origin_mm, grid.cell_mm), np.sqrt(variance))


def _centered(
    height: NDArray[np.float64], off_x: NDArray[np.float64], off_y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Heights moved from where the points lie (offsets in cells) to the cells' centres along the local slope.

    The points' raster beats with the grid's, so the offsets are alike over large areas and would not average out.
    """
    moved = height.copy()
    for axis, off in ((1, off_x), (0, off_y)):
        forward = np.diff(height, axis=axis)
        # both neighbours must tell much the same slope: an edge has none
        one, two = (forward[:-1], forward[1:]) if axis == 0 else (forward[:, :-1], forward[:, 1:])
        slope = 0.5 * (one + two)
        slope = np.where(
            np.abs(one - two) < 0.5 * np.abs(slope) + 0.5 * np.nanmedian(np.abs(forward)), slope, 0.0
        )
        inner = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
        moved[inner] -= np.nan_to_num(slope * off[inner])
    return moved


def _medians(
    cell: NDArray[np.int64], height_mm: NDArray[np.float64], cells: int, gap_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Median, robust scatter (from quartiles) and number of each cell's points above its topmost gap."""
    # one integer per point, cell above height: a plain sort groups and ranks at once
    level = np.rint(height_mm / _QUANTUM_MM).astype(np.int64) + (1 << 35)
    key = np.sort((cell << 36) | np.clip(level, 0, (1 << 36) - 1))
    owner, level = key >> 36, (key & ((1 << 36) - 1)) - (1 << 35)
    count = np.bincount(cell, minlength=cells)
    end = np.cumsum(count)
    first = end - count
    gap = np.flatnonzero((np.diff(level) > gap_mm / _QUANTUM_MM) & (owner[1:] == owner[:-1]))
    first[owner[gap]] = gap + 1  # of several gaps the last written, the topmost, stays
    count = end - first
    full = count > 0
    start, number = first[full], count[full]

    def ranked(rank: NDArray[np.int64]) -> NDArray[np.float64]:
        return level[start + rank].astype(np.float64) * _QUANTUM_MM

    median, scatter = np.full(cells, np.nan), np.full(cells, np.nan)
    median[full] = 0.5 * (ranked((number - 1) // 2) + ranked(number // 2))
    scatter[full] = (ranked((3 * (number - 1) + 2) // 4) - ranked((number - 1) // 4)) / 1.349
    return median, scatter, count
