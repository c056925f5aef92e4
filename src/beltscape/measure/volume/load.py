"""The height of the load over the empty belt, on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt.empty_belt import Belt
from beltscape.core.belt.height_map import HeightMap
from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.measure.holes.fill import Filled
from beltscape.measure.reliable_pixels import reliable_mask
from beltscape.measure.surface import (
    Grid,
    average_blocks,
    close_pinholes,
    compute_height_map,
    compute_sampling,
)


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """Loaded minus empty height, with its σ."""

    grid: Grid
    """The cells in the belt frame."""
    height_mm: NDArray[np.float64]
    """(Ny, Nx) load over the empty belt; NaN where it was not measured."""
    sigma_mm: NDArray[np.float64]
    """(Ny, Nx) σ of ``height_mm``."""
    noise_mm: NDArray[np.float64]
    """(Ny, Nx) the part of σ that neighbouring cells share."""
    measured: NDArray[np.bool_]
    """(Ny, Nx) whether a cell was measured, the pinholes between neighbouring points included."""
    ray_slope: NDArray[np.float64]
    """(2, Ny, Nx) slope of the core's rays from the vertical, in x and y, positive away from the core."""


def compute_load(loaded: DepthMap, camera: Camera, belt: Belt, grid: Grid) -> Load:
    """Return the load over the empty belt on a grid, from reliable pixels only.

    Where the depth map of the empty belt stated less noise than it had, σ is raised by the same factor.
    """
    pose = belt.belt_from_core
    sampling = compute_sampling(loaded, camera)
    use = reliable_mask(loaded, sampling.pixel_mm, sampling.step_mm, belt.correlation_px)
    top = compute_height_map(loaded, camera, pose, grid, use, sampling)
    bottom = belt.surface_mm(grid.x_mm, grid.y_mm)
    height = top.heights.height_mm - bottom
    noise_factor = max(1.0, belt.noise_mm / max(belt.claimed_sigma_mm, 1e-9))
    sigma = np.hypot(noise_factor * top.heights.sigma_mm, belt.surface_sigma_mm(grid.x_mm, grid.y_mm))
    # a point well below the empty belt is a mismatch
    valid = height > -(10 * belt.noise_mm + 3 * grid.cell_mm)
    eye = pose.translation_mm
    reach = np.maximum(eye[2] - bottom, 1.0)
    return Load(
        grid,
        np.where(valid, height, np.nan),
        np.where(valid, sigma, np.nan),
        np.where(valid, noise_factor * top.noise_mm, np.nan),
        close_pinholes(valid),
        np.stack([(grid.x_mm[None] - eye[0]) / reach, (grid.y_mm[:, None] - eye[1]) / reach]),
    )


def average_load(load: Load, filled: Filled, side: int) -> HeightMap:
    """Return the filled load as means over blocks of ``side`` cells; σ does not fall, as errors are correlated."""
    shift = (side - 1) / 2 * load.grid.cell_mm
    origin = (load.grid.origin_mm[0] + shift, load.grid.origin_mm[1] + shift)
    sigma = np.sqrt(average_blocks(filled.sigma_mm**2, side))
    return HeightMap(average_blocks(filled.value_mm, side), sigma, origin, load.grid.cell_mm * side)
