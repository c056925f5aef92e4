"""The depth map on a coarser raster, as heights in cell widths, so that lumps appear alike for every rig."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera

_MIN_WEIGHT = 0.02
"""Share of measured cells in a window from which an unmeasured cell is interpolated."""


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """A depth map reduced by a whole factor; R × C cells of ``factor`` × ``factor`` pixels."""

    depth_mm: NDArray[np.float64]
    """(R, C) depth, with holes filled from the measured cells around them."""
    measured: NDArray[np.bool_]
    """(R, C) whether any pixel of the cell was measured."""
    height_px: NDArray[np.float32]
    """(R, C) height towards the camera, in widths of a cell on the surface."""
    rays: NDArray[np.float64]
    """(R, C, 2) x/z, y/z of the cells' centres."""
    factor: int
    """Pixels per cell, along both axes."""
    cell_rad: float
    """Width of a cell over its depth."""

    @property
    def points_mm(self) -> NDArray[np.float64]:
        """Return the points (R, C, 3) in the core camera's frame."""
        depth = self.depth_mm[..., None]
        return np.concatenate([self.rays * depth, depth], axis=-1)


def make_raster(depth: DepthMap, camera: Camera, pixels: int) -> Raster | None:
    """Reduce a depth map to about ``pixels`` cells; return None where nothing is measured.

    A cell takes the lower median of its pixels' depths, which at a step is that of the upper surface.
    """
    rows, columns = depth.depth_mm.shape
    factor = max(1, int(np.ceil(np.sqrt(rows * columns / pixels) - 0.05)))
    high, wide = rows // factor, columns // factor
    block = depth.depth_mm[: high * factor, : wide * factor].reshape(high, factor, wide, factor)
    block = np.sort(
        block.transpose(0, 2, 1, 3).reshape(high, wide, factor * factor), axis=-1
    )  # NaN goes last
    number = np.isfinite(block).sum(axis=-1)
    middle = np.maximum((number - 1) // 2, 0)[..., None]
    value = np.take_along_axis(block, middle, axis=-1)[..., 0]
    measured = number > 0
    if not measured.any():
        return None
    filled = fill_gaps(value, measured)
    cell_rad = factor / float(camera.focal_px.mean())
    cell_mm = float(np.median(value[measured])) * cell_rad
    at = camera.rays()[: high * factor, : wide * factor]
    rays = at.reshape(high, factor, wide, factor, 2).mean(axis=(1, 3))
    return Raster(
        filled.astype(np.float64), measured, (-filled / np.float32(cell_mm)), rays, factor, cell_rad
    )


def fill_gaps(value: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill unknown cells (R, C) by Gaussian means of known ones, with the narrowest Gaussian that reaches any.

    Normalised convolution, Knutsson & Westin 1993, 10.1109/CVPR.1993.341081.
    """
    middle = np.float32(np.median(value[known]))
    whole = np.where(known, value, middle)
    left = ~known
    weight = known.astype(np.float32)
    offset = np.where(known, value - middle, 0).astype(np.float32)
    sigma = 1.0
    while left.any() and sigma < 4 * max(value.shape):
        total, share = blur(offset, sigma), blur(weight, sigma)
        reached = left & (share > _MIN_WEIGHT)
        whole[reached] = middle + total[reached] / share[reached]
        left &= ~reached
        sigma *= 2
    return whole.astype(np.float32)


def blur(values: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Return the Gaussian mean; wide Gaussians are computed on a coarser grid to save time."""
    if sigma <= 16:
        return np.asarray(
            cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101), np.float32
        )
    step = int(sigma // 8)
    small = (max(values.shape[1] // step, 1), max(values.shape[0] // step, 1))
    coarse = cv2.resize(values, small, interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(coarse, (0, 0), sigma / step, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(cv2.resize(coarse, values.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
