"""Structured-light scanner: depth on the core camera's pinhole grid from shifted fringes of one projector.

The projector is modelled as an inverse camera. A core pixel's ray (x, y, 1)·z meets the plane of the projector
column u where, with R, t the projector's pose and ũ = (u − cx)/fx,

    z = (ũ·t_z − t_x) / (R₁·d − ũ·R₃·d),   ∂z/∂ũ = (t_z + z·R₃·d) / (R₁·d − ũ·R₃·d).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.ndimage import map_coordinates

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.evaluate.baselines.phase import estimate_phase, unwrap_phases
from beltscape.simulate.sensors.fringes import FringeSettings

Array = NDArray[np.float64]


class DecodeSettings(BaseModel):
    """Camera noise and acceptance limits of the decoding."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    read_noise: Annotated[float, Field(ge=0, le=100)] = 0.4
    """Dark noise of the camera, counts, including the rounding to whole counts."""
    electrons_per_count: Annotated[float, Field(gt=0, le=1e6)] = 55.0
    """Shot noise is √(counts / this)."""
    least_modulation: Annotated[float, Field(ge=0, le=255)] = 3.0
    """Smallest fringe modulation that is measured, counts."""
    most_sigma_mm: Annotated[float, Field(gt=0, le=1e3)] = 2.0
    """Largest σ of a measured depth."""
    gate: Annotated[float, Field(gt=0, le=100)] = 6.0
    """Largest difference of fringe sets in units of σ; beyond it a pixel shows two surfaces."""
    brightest: Annotated[int, Field(ge=1, le=255)] = 254
    """Counts; above lies saturation."""


def decode(
    images: NDArray[np.uint8],
    core: Camera,
    projector: Camera,
    projector_from_core: Pose,
    fringes: FringeSettings,
    settings: DecodeSettings | None = None,
) -> DepthMap:
    """Return the depth from a sequence of fringe images.

    Parameters
    ----------
    images
        (F, H, W) distorted images of the core camera, in the order of `fringe_pictures`.
    core, projector, projector_from_core
        Calibrated: the projector is without distortion.
    fringes
        The projected fringes.
    settings
        Noise and acceptance limits.

    Raises
    ------
    InputError
        When there are not as many images as pictures were projected.
    """
    if len(images) != fringes.frames:
        raise InputError(f"{len(images)} images of {fringes.frames} pictures; give one of each")
    settings = settings or DecodeSettings()
    flat = _undistort(images, core)
    noise = np.sqrt(settings.read_noise**2 + flat.mean(axis=0).clip(min=0) / settings.electrons_per_count)
    sets = flat.reshape(len(fringes.fringes), fringes.steps, *flat.shape[1:])
    phases = [estimate_phase(one, noise) for one in sets]
    column, sigma_px = unwrap_phases(phases, fringes.periods_px(projector.size_px[0]), settings.gate)
    depth, per_px = _triangulate(column, core, projector, projector_from_core)
    sigma = np.abs(per_px) * sigma_px
    good = np.isfinite(depth) & (depth > 0) & (sigma <= settings.most_sigma_mm)
    good &= np.min([phase.modulation for phase in phases], axis=0) >= settings.least_modulation
    good &= _undistort(images.max(axis=0)[None], core)[0] <= settings.brightest
    return DepthMap(
        np.where(good, depth, np.nan).astype(np.float32),
        np.where(good, sigma, np.nan).astype(np.float32),
        good.astype(np.uint8),
        good.astype(np.float32),
    )


def _triangulate(column: Array, core: Camera, projector: Camera, pose: Pose) -> tuple[Array, Array]:
    """Return the depth (H, W) of projector columns (H, W), and its derivative in mm per column."""
    rays = np.concatenate([core.rays(), np.ones((*column.shape, 1))], axis=-1)
    across, along = rays @ pose.rotation[0], rays @ pose.rotation[2]
    u = (column - projector.center_px[0]) / projector.focal_px[0]
    t_x, _, t_z = pose.translation_mm
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = across - u * along
        depth = (u * t_z - t_x) / slope
        return depth, (t_z + depth * along) / slope / projector.focal_px[0]


def _undistort(images: NDArray[np.uint8], core: Camera) -> NDArray[np.float32]:
    """Return the counts (F, H, W) on the camera's pinhole grid, by cubic splines; 0 outside the image.

    OpenCV's remap is not used because it rounds positions to 1/32 px, which exceeds the phase noise.
    """
    u, v = np.moveaxis(core.distort(core.rays()) * core.focal_px + core.center_px, -1, 0)
    flat = [map_coordinates(one.astype(np.float32), (v, u), order=3) for one in images]
    return np.stack(flat).astype(np.float32)
