"""Height maps: the heights of a depth map on a grid in the belt frame, and the choice of its reliable pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.height_map import HeightMap
from beltscape.core.statistics import compute_median
from beltscape.kernels import load_on_processor

_GRAZING = float(np.tan(np.deg2rad(10.0)))
"""Rise of a ray over its run at which it grazes a surface; longer triangles are no surface."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A grid of square cells in the belt frame."""

    origin_mm: tuple[float, float]
    """(x, y) of the centre of cell (0, 0)."""
    cell_mm: float
    """Edge of a cell."""
    shape: tuple[int, int]
    """(Ny, Nx)."""

    @property
    def x_mm(self) -> NDArray[np.float64]:
        """Return the centres of the columns (Nx,)."""
        return self.origin_mm[0] + self.cell_mm * np.arange(self.shape[1], dtype=np.float64)

    @property
    def y_mm(self) -> NDArray[np.float64]:
        """Return the centres of the rows (Ny,)."""
        return self.origin_mm[1] + self.cell_mm * np.arange(self.shape[0], dtype=np.float64)

    @classmethod
    def over(cls, across_mm: tuple[float, float], along_mm: tuple[float, float], cell_mm: float) -> Grid:
        """Return the smallest grid whose cells' centres enclose a box."""
        columns = int(np.ceil((across_mm[1] - across_mm[0]) / cell_mm)) + 1
        rows = int(np.ceil((along_mm[1] - along_mm[0]) / cell_mm)) + 1
        return cls((across_mm[0], along_mm[0]), cell_mm, (rows, columns))


@dataclass(frozen=True, slots=True, eq=False)
class GridHeights:
    """Heights on a grid, with the correlated part of their uncertainty."""

    heights: HeightMap
    """Height and σ of each cell; NaN where a cell was not measured."""
    noise_mm: NDArray[np.float64]
    """(Ny, Nx) the part of σ that comes from the depth map, shared by neighbouring cells."""


def average_blocks(values: NDArray[np.generic], side: int) -> NDArray[np.float64]:
    """Return means (Ny // side, Nx // side) over square blocks of cells; a remainder at the far ends is left out."""
    rows, columns = values.shape[0] // side, values.shape[1] // side
    blocks = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return blocks.astype(np.float64).mean(axis=(1, 3))


def close_pinholes(measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the measured cells (Ny, Nx) together with the pinholes between neighbouring points."""
    padded = np.pad(measured, 1).astype(np.uint8)
    return cv2.morphologyEx(padded, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0


@dataclass(frozen=True, slots=True)
class Sampling:
    """The sampling of a surface by a depth map."""

    pixel_mm: float
    """Edge of a pixel on a surface perpendicular to the axis at the median depth."""
    step_mm: float
    """Largest depth step between neighbouring pixels of one surface: at a grazing angle of 10°, below which no
    matcher measures."""


_SAMPLED, _LARGE_PX = 3, 200
"""Every third pixel of a row and of a column gives the median depth of images from this size on to 0.03 %, that of σ
to 0.2 % of 612×512 and to 1 % of 306×256 pixels; the step between neighbours follows from both."""


def compute_sampling(depth: DepthMap, camera: Camera) -> Sampling:
    """Return the sampling of a depth map in a camera's view."""
    part = slice(None, None, _SAMPLED if min(depth.depth_mm.shape) >= _LARGE_PX else 1)
    depth_mm, sigma_mm = depth.depth_mm[part, part], depth.sigma_mm[part, part]
    measured = np.isfinite(depth_mm)
    if not measured.any():  # single pixels that the sample misses
        depth_mm, sigma_mm, measured = depth.depth_mm, depth.sigma_mm, depth.measured
    distance_mm, noise_mm = (
        compute_median(values[measured]) if measured.any() else 0.0 for values in (depth_mm, sigma_mm)
    )
    pixel_mm = distance_mm / float(camera.focal_px.mean())
    return Sampling(pixel_mm, pixel_mm / _GRAZING + 6 * noise_mm)


def _grid_from_pixel(
    camera: Camera, belt_from_core: Pose, start_mm: NDArray[np.float64], cell_mm: float
) -> NDArray[np.float64]:
    """Return the (3, 4) transform from pixels times depth to columns, rows (0 at ``start_mm`` (2,)) and height mm."""
    offset = belt_from_core.translation_mm - [*start_mm, 0.0]
    transform = np.column_stack([belt_from_core.rotation @ np.linalg.inv(camera.matrix), offset])
    transform[:2] /= cell_mm
    return transform


def compute_height_map(
    depth: DepthMap,
    camera: Camera,
    belt_from_core: Pose,
    grid: Grid,
    use: NDArray[np.bool_],
    sampling: Sampling,
) -> GridHeights:
    """Return the height of the top surface over each cell, from the pixels ``use`` (H, W).

    Neighbouring pixels of one surface are joined to triangles, which are rasterised from vertically above. So every
    cell is weighted by its own area, whatever the density of the pixels, and of several layers the uppermost
    counts, since an overhang counts as solid. A cell much larger than a pixel is the mean over sub-cells of a
    pixel's size, where most of these hit the surface. σ is that of the pixels: the errors of neighbours are
    correlated, so it does not fall with their number.
    """
    side = max(1, round(grid.cell_mm / sampling.pixel_mm)) if use.any() else 1
    fine_mm = grid.cell_mm / side
    shape = (grid.shape[0] * side, grid.shape[1] * side)
    start = np.array(grid.origin_mm) - 0.5 * (side - 1) * fine_mm
    transform = _grid_from_pixel(camera, belt_from_core, start, fine_mm)
    height, variance = load_on_processor().rasterise_heights(
        depth.depth_mm, depth.sigma_mm, use, transform, sampling.step_mm, shape
    )
    if side > 1:
        measured = np.isfinite(height)
        share = average_blocks(measured, side)
        with np.errstate(invalid="ignore", divide="ignore"):
            height, variance = (
                np.where(share > 0.5, average_blocks(np.where(measured, part, 0.0), side) / share, np.nan)
                for part in (height, variance)
            )
    sigma = np.sqrt(variance)
    return GridHeights(HeightMap(height, sigma, grid.origin_mm, grid.cell_mm), sigma)


FULL_CONFIDENCE = 0.999
"""A depth map whose confidence is this high everywhere does not rate its pixels."""


def reliable_mask(depth: DepthMap, pixel_mm: float, step_mm: float, window_px: float) -> NDArray[np.bool_]:
    """Return which pixels (H, W) are reliable enough to measure by.

    A pixel is excluded

    - if its σ exceeds both four typical σ and a pixel's size on the surface (``pixel_mm``);
    - if only one auxiliary measured it, where three or more are usual: nothing confirms it;
    - if it differs by more than ``step_mm`` from most of its neighbours: it is a flying pixel between two surfaces;
    - if most of its neighbours, within the matcher's windows ``window_px``, are excluded for these reasons or not
      measured: false matches in shadows and beside steps form such fragments.

    Where the depth map rates its pixels, its confidence is used instead: pixels below one half and flying pixels are
    excluded. Excluding more would make holes wider, and the height in a wide hole beside a step is less certain than
    that of an uncertain pixel.
    """
    measured = depth.measured
    if not measured.any():
        return measured
    if depth.confidence.min(where=measured, initial=1.0) < FULL_CONFIDENCE:
        return measured & (depth.confidence >= 0.5) & _continuous_mask(depth.depth_mm, step_mm)
    typical = compute_median(depth.sigma_mm[measured])
    reliable = measured & (depth.sigma_mm <= max(pixel_mm, 4 * typical))
    reliable &= _continuous_mask(depth.depth_mm, step_mm)
    if np.median(depth.views[measured]) >= 3:
        reliable &= depth.views >= 2
    if not reliable.any():
        return reliable
    side = 2 * round(window_px / 2) + 1
    around = ndimage.uniform_filter(reliable.astype(np.float32), side, mode="nearest")
    return reliable & (around >= 0.5 * compute_median(around[reliable]))


@dataclass(frozen=True, slots=True, eq=False)
class ReliablePixels:
    """The pixels of a depth map by which is measured."""

    use: NDArray[np.bool_]
    """(H, W)"""
    sampling: Sampling


def _continuous_mask(depth_mm: NDArray[np.float32], step_mm: float) -> NDArray[np.bool_]:
    """Return the pixels (H, W) continuous with two of four neighbours, or with all where fewer are measured."""
    measured = np.isfinite(depth_mm)
    near, there = np.zeros(depth_mm.shape, np.int8), np.zeros(depth_mm.shape, np.int8)
    for axis in (0, 1):
        before, after = ((slice(None),) * axis + (part,) for part in (slice(None, -1), slice(1, None)))
        is_near = np.abs(depth_mm[after] - depth_mm[before]) <= step_mm
        for here, other in ((before, after), (after, before)):
            near[here] += is_near
            there[here] += measured[other]
    return near >= np.minimum(there, 2)
