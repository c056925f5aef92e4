"""The load's height over the empty belt, on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt import HeightMap
from beltscape.core.belt_model import Belt
from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.measure.holes.fill import Filled
from beltscape.measure.surface import Grid, blocks_mean, closed, height_map, sampling_of
from beltscape.measure.trust import trusted

_JUDGED = 0.999
"""A depth map that trusts every pixel wholly does not judge them."""


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """Loaded minus empty height."""

    grid: Grid
    """Where the cells lie."""
    height_mm: NDArray[np.float64]
    """(Ny, Nx) load over the empty belt; NaN where it was not measured."""
    sigma_mm: NDArray[np.float64]
    """(Ny, Nx) its σ."""
    noise_mm: NDArray[np.float64]
    """(Ny, Nx) the part of σ that neighbouring cells share."""
    measured: NDArray[np.bool_]
    """(Ny, Nx) where it was measured, the pinholes between neighbouring points included."""
    lean: NDArray[np.float64]
    """(2, Ny, Nx) tangents, in x and in y, of the angle at which the core's rays come down there, away from it."""
    windowed: bool
    """Whether a matcher that judges its pixels measured it: its windows reach across edges."""


def load_over_belt(loaded: DepthMap, camera: Camera, belt: Belt, grid: Grid) -> Load:
    """Load over the empty belt on a grid; cells that are not trustworthy count as not measured.

    A depth map that claims less noise than the empty belt's has there has its σ raised to that.
    """
    pose = belt.belt_from_core
    sampling = sampling_of(loaded, camera)
    use = trusted(loaded, sampling.pixel_mm, sampling.step_mm, belt.correlation_px)
    top = height_map(loaded, camera, pose, grid, use, sampling)
    bottom = belt.surface_mm(grid.x_mm, grid.y_mm)
    height = top.heights.height_mm - bottom
    raised = max(1.0, belt.noise_mm / max(belt.claimed_sigma_mm, 1e-9))
    sigma = np.hypot(raised * top.heights.sigma_mm, belt.surface_sigma_mm(grid.x_mm, grid.y_mm))
    # what lies well below the empty belt is no surface
    good = height > -(10 * belt.noise_mm + 3 * grid.cell_mm)
    eye = pose.translation_mm
    reach = np.maximum(eye[2] - bottom, 1.0)
    return Load(
        grid,
        np.where(good, height, np.nan),
        np.where(good, sigma, np.nan),
        np.where(good, raised * top.noise_mm, np.nan),
        closed(good),
        np.stack([(grid.x_mm[None] - eye[0]) / reach, (grid.y_mm[:, None] - eye[1]) / reach]),
        bool(loaded.measured.any() and loaded.confidence[loaded.measured].min() < _JUDGED),
    )


def gathered(load: Load, filled: Filled, side: int) -> HeightMap:
    """The load without holes, as means over blocks of ``side`` cells; σ does not fall, the errors are shared."""
    shift = (side - 1) / 2 * load.grid.cell_mm
    origin = (load.grid.origin_mm[0] + shift, load.grid.origin_mm[1] + shift)
    sigma = np.sqrt(blocks_mean(filled.sigma_mm**2, side))
    return HeightMap(blocks_mean(filled.value_mm, side), sigma, origin, load.grid.cell_mm * side)
