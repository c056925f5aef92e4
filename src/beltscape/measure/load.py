"""The load's height over the empty belt, on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.belt import HeightMap
from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.measure.belt import Belt
from beltscape.measure.holes import Filled
from beltscape.measure.surface import Grid, blocks_mean, height_map, pixel_size_mm, visible_step_mm
from beltscape.measure.trust import trusted


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """Loaded minus empty height."""

    grid: Grid
    """Where the cells lie."""
    height_mm: NDArray[np.float64]
    """(Ny, Nx) load over the empty belt; NaN where either was not measured."""
    sigma_mm: NDArray[np.float64]
    """(Ny, Nx) its σ."""
    noise_mm: NDArray[np.float64]
    """(Ny, Nx) the part of σ that neighbouring cells share."""

    measured: NDArray[np.bool_]
    """(Ny, Nx) where both surfaces were measured, the pinholes between neighbouring points included."""


def load_over_belt(loaded: DepthMap, empty: DepthMap, camera: Camera, belt: Belt, grid: Grid) -> Load:
    """Load over the empty belt on a grid; cells that are not trustworthy count as not measured.

    The empty surface is the belt's cross-section plus what was measured about it. A depth map that claims less
    noise than it has on the empty belt has its σ raised to that.
    """
    pose = belt.belt_from_core
    pixel_mm, step_mm = pixel_size_mm(empty, camera), visible_step_mm(empty, camera)
    bottom = height_map(empty, camera, pose, grid, trusted(empty, pixel_mm, step_mm, belt.correlation_px))
    even = belt.height_mm(grid.x_mm)[None]
    off = bottom.heights.height_mm - even
    sound = np.abs(off) <= 6 * belt.noise_mm + grid.cell_mm
    bottom_height = even + np.where(sound, off, _smoothed(off, sound, grid.cell_mm))
    top = height_map(
        loaded,
        camera,
        pose,
        grid,
        trusted(loaded, pixel_mm, visible_step_mm(loaded, camera), belt.correlation_px),
    )
    height = top.heights.height_mm - bottom_height
    # what lies well below the empty belt is no surface
    good = sound & (height > -(10 * belt.noise_mm + 3 * grid.cell_mm))
    raised = _raise(empty, belt)
    return Load(
        grid,
        np.where(good, height, np.nan),
        np.where(good, raised * np.hypot(top.heights.sigma_mm, bottom.heights.sigma_mm), np.nan),
        np.where(good, raised * np.hypot(top.noise_mm, bottom.noise_mm), np.nan),
        np.asarray(ndimage.binary_closing(np.pad(good, 1), np.ones((3, 3))), bool)[1:-1, 1:-1],
    )


def _raise(empty: DepthMap, belt: Belt) -> float:
    """Factor from the σ that the depth map claims to the scatter on the even belt, at least one."""
    claimed = float(np.median(empty.sigma_mm[empty.measured]))
    return max(1.0, belt.noise_mm / max(claimed, 1e-9))


def _smoothed(off_mm: NDArray[np.float64], sound: NDArray[np.bool_], cell_mm: float) -> NDArray[np.float64]:
    """Mean of the sound cells about each cell, fading to zero far from any."""
    blur = 10.0 / cell_mm
    value = ndimage.gaussian_filter(np.where(sound, off_mm, 0.0), blur)
    weight = ndimage.gaussian_filter(sound.astype(np.float64), blur)
    return value / (weight + 1e-3)


def gathered(load: Load, filled: Filled, side: int) -> HeightMap:
    """The load without holes, as means over blocks of ``side`` cells; σ does not fall, the errors are shared."""
    shift = (side - 1) / 2 * load.grid.cell_mm
    origin = (load.grid.origin_mm[0] + shift, load.grid.origin_mm[1] + shift)
    sigma = np.sqrt(blocks_mean(filled.sigma_mm**2, side))
    return HeightMap(blocks_mean(filled.value_mm, side), sigma, origin, load.grid.cell_mm * side)
