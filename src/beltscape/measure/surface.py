"""Depth map → heights on a grid in the belt frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt import HeightMap
from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.core.pose import Pose
from beltscape.kernels import load

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
    """Height per cell and its whole σ; NaN where a cell was not measured."""
    noise_mm: NDArray[np.float64]
    """(Ny, Nx) the part of σ that neighbouring cells share: the depth map's own."""


def blocks_mean(values: NDArray[np.generic], side: int) -> NDArray[np.float64]:
    """Means (Ny // side, Nx // side) over square blocks of cells; a rest at the far ends is left out."""
    rows, columns = values.shape[0] // side, values.shape[1] // side
    blocks = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return blocks.astype(np.float64).mean(axis=(1, 3))


def closed(measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(Ny, Nx) measured cells and the pinholes between neighbouring points."""
    padded = np.pad(measured, 1).astype(np.uint8)
    return cv2.morphologyEx(padded, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0


@dataclass(frozen=True, slots=True)
class Sampling:
    """How finely a depth map samples a surface."""

    pixel_mm: float
    """Edge of a pixel on a surface square to the axis at the median depth."""
    step_mm: float
    """Largest depth step between neighbouring pixels on one surface: seen under 10°, which no matcher measures."""


def sampling_of(depth: DepthMap, camera: Camera) -> Sampling:
    """Of a depth map in a camera's view."""
    measured = depth.measured
    seen_mm, noise_mm = (
        float(np.median(values[measured])) if measured.any() else 0.0
        for values in (depth.depth_mm, depth.sigma_mm)
    )
    pixel_mm = seen_mm / float(camera.focal_px.mean())
    return Sampling(pixel_mm, pixel_mm / _GRAZING + 6 * noise_mm)


def _grid_from_pixel(
    camera: Camera, belt_from_core: Pose, start_mm: NDArray[np.float64], cell_mm: float
) -> NDArray[np.float64]:
    """(3, 4) from pixels times their depth to columns and rows from ``start_mm`` (2,) on, and heights in mm."""
    moved = belt_from_core.translation_mm - [*start_mm, 0.0]
    transform = np.column_stack([belt_from_core.rotation @ np.linalg.inv(camera.matrix), moved])
    transform[:2] /= cell_mm
    return transform


def height_map(
    depth: DepthMap,
    camera: Camera,
    belt_from_core: Pose,
    grid: Grid,
    use: NDArray[np.bool_],
    sampling: Sampling,
) -> Surface:
    """Height of the top surface over each cell, from the pixels ``use`` (H, W) of a map so sampled.

    Neighbouring pixels of one surface are joined to triangles, and these are looked at from straight above: every
    cell gets the area that is its own, however dense the pixels lie on what is near, far or steep, and of several
    layers the uppermost, for an overhang counts as solid. A cell much larger than a pixel is the mean over such
    looks a pixel apart, where most of them meet the surface. σ is the pixels' own: neighbours err together, so it
    does not fall with their number.
    """
    side = max(1, round(grid.cell_mm / sampling.pixel_mm)) if use.any() else 1
    fine_mm = grid.cell_mm / side
    shape = (grid.shape[0] * side, grid.shape[1] * side)
    start = np.array(grid.origin_mm) - 0.5 * (side - 1) * fine_mm
    transform = _grid_from_pixel(camera, belt_from_core, start, fine_mm)
    height, variance = load().top_view(
        depth.depth_mm, depth.sigma_mm, use, transform, sampling.step_mm, shape
    )
    if side > 1:
        measured = np.isfinite(height)
        share = blocks_mean(measured, side)
        with np.errstate(invalid="ignore", divide="ignore"):
            height, variance = (
                np.where(share > 0.5, blocks_mean(np.where(measured, part, 0.0), side) / share, np.nan)
                for part in (height, variance)
            )
    sigma = np.sqrt(variance)
    return Surface(HeightMap(height, sigma, grid.origin_mm, grid.cell_mm), sigma)
