"""Structured light: shifted fringes of one projector, seen by the core camera → depth on its pinhole grid.

The projector is a second camera that sees its own columns. A pixel's ray (x, y, 1)·z of the core and the plane of a
projector column u meet where, with R, t the projector's pose and ũ = (u − cx)/fx,

    z = (ũ·t_z − t_x) / (R₁·d − ũ·R₃·d),   ∂z/∂ũ = (t_z + z·R₃·d) / (R₁·d − ũ·R₃·d).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.ndimage import map_coordinates

from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.pose import Pose
from beltscape.evaluate.baselines.phase import estimate_phase, unwrap_phases
from beltscape.simulate.sensors.fringes import FringeSettings

Array = NDArray[np.float64]


class DecodeSettings(BaseModel):
    """What is trusted."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    read_noise: Annotated[float, Field(ge=0, le=100)] = 0.4
    """Of the camera in the dark, counts, the rounding to whole counts included."""
    electrons_per_count: Annotated[float, Field(gt=0, le=1e6)] = 55.0
    """Shot noise is √(counts / this)."""
    least_modulation: Annotated[float, Field(ge=0, le=255)] = 3.0
    """Counts; darker is not measured."""
    most_sigma_mm: Annotated[float, Field(gt=0, le=1e3)] = 2.0
    """Of the depth; what is worse is not measured."""
    gate: Annotated[float, Field(gt=0, le=100)] = 6.0
    """Sets of fringes that differ by more of their σ see two surfaces in one pixel."""
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
    """Depth from a sequence of images.

    Parameters
    ----------
    images
        (F, H, W) as the core camera took them, in the order of `fringe_pictures`.
    core, projector, projector_from_core
        Calibrated: the projector is without distortion.
    fringes
        What was projected.
    settings
        What is trusted.

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
    """(H, W) depth of projector columns (H, W), and by how many mm it grows with a column."""
    rays = np.concatenate([core.rays(), np.ones((*column.shape, 1))], axis=-1)
    across, along = rays @ pose.rotation[0], rays @ pose.rotation[2]
    u = (column - projector.center_px[0]) / projector.focal_px[0]
    t_x, _, t_z = pose.translation_mm
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = across - u * along
        depth = (u * t_z - t_x) / slope
        return depth, (t_z + depth * along) / slope / projector.focal_px[0]


def _undistort(images: NDArray[np.uint8], core: Camera) -> NDArray[np.float32]:
    """(F, H, W) counts on the camera's pinhole grid, by cubic splines; 0 where it did not look.

    Not by OpenCV's remap: it rounds places to a 32nd of a pixel, which is more than the noise of the phase.
    """
    u, v = np.moveaxis(core.distort(core.rays()) * core.focal_px + core.center_px, -1, 0)
    flat = [map_coordinates(one.astype(np.float32), (v, u), order=3) for one in images]
    return np.stack(flat).astype(np.float32)
