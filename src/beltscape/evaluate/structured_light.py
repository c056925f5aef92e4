"""Structured-light scanner: depth on the core camera's pinhole grid from shifted fringes of one projector.

The projector is modelled as an inverse camera. A core pixel's ray (x, y, 1)·z meets the plane of the projector
column u where, with R, t the projector's pose and ũ = (u − cx)/fx,

    z = (ũ·t_z − t_x) / (R₁·d − ũ·R₃·d),   ∂z/∂ũ = (t_z + z·R₃·d) / (R₁·d − ũ·R₃·d).

The phase of shifted fringes: N images of intensity A + B·cos(φ − 2πk/N) give by least squares (Zuo et al., Optics and
Lasers in Engineering 109, 2018, 23-59, doi:10.1016/j.optlaseng.2018.04.019)

    φ = atan2(Σ Iₖ sin 2πk/N, Σ Iₖ cos 2πk/N),   B = 2/N · √(Σ² + Σ²),   σ_φ = √(2/N) · σ_I / B.

A coarse fringe set determines the period of the next finer one: hierarchical temporal unwrapping
(Zuo et al., Optics and Lasers in Engineering 85, 2016, 84-103, doi:10.1016/j.optlaseng.2016.04.022, section 2.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.ndimage import map_coordinates

from beltscape.core.arrays import Array
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.projected_sequence import FringeSettings


@dataclass(frozen=True, slots=True, eq=False)
class Phase:
    """The phase of one fringe set."""

    phase: Array
    """(H, W) radians in 0 … 2π."""
    modulation: Array
    """(H, W) B, counts."""
    sigma: Array
    """(H, W) one standard deviation of the phase, radians; inf without modulation."""


def estimate_phase(images: NDArray[np.floating], noise: NDArray[np.floating]) -> Phase:
    """Return the phase of N ≥ 3 images (N, H, W) shifted by 1/N period each; ``noise`` (H, W) is their σ, counts."""
    steps = 2 * np.pi * np.arange(len(images)) / len(images)
    sine, cosine = (np.tensordot(f(steps), images.astype(np.float64), 1) for f in (np.sin, np.cos))
    modulation = 2 / len(images) * np.hypot(sine, cosine)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.sqrt(2 / len(images)) * noise / modulation
    return Phase(
        np.mod(np.arctan2(sine, cosine), 2 * np.pi), modulation, np.where(modulation > 0, sigma, np.inf)
    )


def unwrap_phases(phases: Sequence[Phase], periods_px: Sequence[float], gate: float) -> tuple[Array, Array]:
    """Return the projector column (H, W) and its σ (H, W), px; NaN where two fringe sets contradict each other.

    Parameters
    ----------
    phases
        Coarse first; the first has a single period.
    periods_px
        Of each, on the projector.
    gate
        Largest difference of two sets in units of their common σ; it is also limited to a third of the finer period.
    """
    column = phases[0].phase / (2 * np.pi) * periods_px[0]
    sigma = phases[0].sigma / (2 * np.pi) * periods_px[0]
    # the single fringe of the first set wraps at the image border, so the phase may fall to either side there
    for phase, period in zip(phases[1:], periods_px[1:], strict=True):
        fine, fine_sigma = (value / (2 * np.pi) * period for value in (phase.phase, phase.sigma))
        off = np.mod(fine - column + period / 2, period) - period / 2
        limit = np.minimum(gate * np.hypot(sigma, fine_sigma), period / 3)
        column = np.where(np.abs(off) <= limit, column + off, np.nan)
        sigma = np.where(np.isfinite(column), fine_sigma, np.nan)
    return column, sigma


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
