"""A sphere from the cap that one sees, without the bias of the matcher's windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.kernels import load
from beltscape.measure.features.face import rays_at
from beltscape.measure.features.smoothing import smoothed
from beltscape.measure.features.view import scale_of

_CAP_DEG = 55.0
"""Seen at more than this from the normal, a surface is measured badly, and towards its limb not at all."""
_LEAST = 60
_OFF_MM, _LEAST_SHARE = 4.0, 0.3
"""With less of it than this share so near to where it should be, the sphere is not there."""
_FLOOR_MM, _LEAST_MM = 0.02, 0.002
"""Of a depth whose σ is less; of a radius whose σ would be less."""
_GRAIN_PX = 45.0
"""Pixels that err as one: about a dot."""
_ROUNDS = 4
_SMOOTHED_PX = 2.3
"""Without weights the smoothing stays in, some (this)² / radius of the radius (simulated modules): then part of σ."""
_WITHIN = 0.3
"""A radius differs from the perfect module's by less than this share."""


@dataclass(frozen=True, slots=True, eq=False)
class Ball:
    """A fitted sphere."""

    center_mm: NDArray[np.float64]
    """(3,) in the core's frame."""
    radius_mm: float
    sigma_mm: float
    """Of the radius."""
    points: int
    corrected_mm: float
    """Mean depth that the matcher's smoothing had added and that was taken off."""


def fit_sphere(
    depth: DepthMap,
    camera: Camera,
    shown: NDArray[np.bool_],
    center_mm: NDArray[np.float64],
    radius_mm: float,
    weight: NDArray[np.float64] | None,
    nearness_mm: float,
) -> Ball | None:
    """Sphere through the measured pixels of ``shown`` (H, W); None where too few are.

    Residuals are depths along the rays, weighted by the pixels' ``weight`` (H, W, `information`:
    what carries no dot was interpolated by the matcher) and 1/σ⁴ (the flank's σ, the larger ones, are optimistic).
    A window's plane lies below the cap it was fitted to; how far follows by doing the same to the fitted sphere, and
    is taken off where that explains the residuals better (it does where the depth came of matching).
    """
    kernels = load()
    window, pixel = _window(camera, center_mm, radius_mm), center_mm[2] / float(camera.focal_px.mean())
    rays = rays_at(camera, *np.mgrid[window])
    z, sigma, on = (a[window].astype(np.float64) for a in (depth.depth_mm, depth.sigma_mm, shown))
    tell = np.ones_like(z) if weight is None else weight[window]
    sound = (on > 0) & (np.asarray(ndimage.distance_transform_edt(np.isfinite(z))) > 2)
    start = _depth(np.append(center_mm, radius_mm), rays)
    there = on > 0
    if np.mean(np.abs(z - start)[there] < _OFF_MM if there.any() else [False]) < _LEAST_SHARE:
        return None
    sphere, inverse, points = np.append(center_mm, radius_mm), np.eye(4), 0
    off, corrected = np.zeros_like(z), 0.0
    for turn in range(_ROUNDS):
        model = _depth(sphere, rays)
        lean = _lean_deg(sphere, rays, model)
        if weight is not None and turn:
            off = smoothed(model, tell, nearness_mm, scale_of(camera), kernels) - model
            off = off if _explains(z - model, off, sound & (lean < 30)) else np.zeros_like(z)
        use = sound & (lean < _CAP_DEG) & np.isfinite(off) & (np.abs(z - model) < 0.3 * radius_mm)
        if use.sum() < _LEAST:
            return None
        trust = np.minimum(tell[use] / max(float(np.median(tell[use])), 1e-12), 5)
        trust /= np.hypot(_FLOOR_MM, sigma[use]) ** 4
        fitted = _fit(sphere, rays[use], (z - off)[use], trust, radius_mm)
        sphere, (inverse, points) = fitted, _covariance(fitted, rays[use], (z - off)[use], trust)
        corrected = float(np.mean(off[use]))
    grain = _GRAIN_PX * scale_of(camera) ** 2
    unknown = 0.0 if weight is not None else (_SMOOTHED_PX * scale_of(camera) * pixel) ** 2 / radius_mm
    sigma = float(np.sqrt(inverse[3, 3] * grain + unknown**2 + _LEAST_MM**2))
    return Ball(sphere[:3], float(sphere[3]), sigma, points, corrected)


def _window(camera: Camera, center_mm: NDArray[np.float64], radius_mm: float) -> tuple[slice, slice]:
    reach = 1.3 * radius_mm * float(camera.focal_px.max()) / center_mm[2] + 8
    middle = center_mm[:2] / center_mm[2] * camera.focal_px + camera.center_px
    low, high = np.maximum(middle - reach, 0).astype(int), np.minimum(middle + reach + 1, camera.size_px)
    high = np.maximum(high.astype(int), low)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _depth(sphere: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) depth of the near side of a sphere (centre, radius) on rays (..., 3); NaN beside it."""
    center, radius = sphere[:3], sphere[3]
    a, b = np.sum(rays**2, axis=-1), rays @ center
    with np.errstate(invalid="ignore"):
        return (b - np.sqrt(b * b - a * (center @ center - radius**2))) / a


def _lean_deg(
    sphere: NDArray[np.float64], rays: NDArray[np.float64], depth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(...) angle between the ray and the normal; 90 beside the sphere."""
    normal = (rays * depth[..., None] - sphere[:3]) / sphere[3]
    cosine = -np.sum(normal * rays, axis=-1) / np.linalg.norm(rays, axis=-1)
    return np.rad2deg(np.arccos(np.clip(np.nan_to_num(cosine), 0, 1)))


def _explains(residual: NDArray[np.float64], off: NDArray[np.float64], where: NDArray[np.bool_]) -> bool:
    """Whether the residuals go with what smoothing would do, from pixel to pixel."""
    there = where & np.isfinite(residual) & np.isfinite(off)
    if there.sum() < 20:
        return False
    left, expected = residual[there] - np.median(residual[there]), off[there] - np.median(off[there])
    limit = 3 * 1.4826 * np.median(np.abs(left)) + 1e-6
    return float(expected @ np.clip(left, -limit, limit)) > 0.5 * float(expected @ expected)


def _fit(
    start: NDArray[np.float64],
    rays: NDArray[np.float64],
    z: NDArray[np.float64],
    trust: NDArray[np.float64],
    nominal_mm: float,
) -> NDArray[np.float64]:
    """Sphere that minimises soft-L1 depth residuals over their robust spread."""
    root = np.sqrt(trust / np.median(trust))
    spread = 1.4826 * float(np.median(np.abs((z - _depth(start, rays)) * root))) + 1e-4

    def residual(sphere: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.nan_to_num(z - _depth(sphere, rays), nan=nominal_mm) * root / spread

    reach = np.array([nominal_mm] * 3 + [_WITHIN * nominal_mm])
    middle = np.append(start[:3], nominal_mm)
    start = np.clip(start, middle - 0.999 * reach, middle + 0.999 * reach)
    answer = optimize.least_squares(
        residual, start, loss="soft_l1", f_scale=2.0, x_scale=0.1, bounds=(middle - reach, middle + reach)
    )
    return np.asarray(answer.x, np.float64)


def _covariance(
    sphere: NDArray[np.float64], rays: NDArray[np.float64], z: NDArray[np.float64], trust: NDArray[np.float64]
) -> tuple[NDArray[np.float64], int]:
    """(4, 4) for independent pixels, and how many of them the fit did not turn down."""
    root = np.sqrt(trust / np.median(trust))
    left = (z - _depth(sphere, rays)) * root
    spread = 1.4826 * float(np.nanmedian(np.abs(left))) + 1e-6
    kept = np.abs(left) < 4 * spread
    steps = 1e-4 * np.eye(4)
    slopes = np.stack([(_depth(sphere + d, rays) - _depth(sphere - d, rays)) / 2e-4 for d in steps], axis=-1)
    slopes = (slopes * root[:, None] / spread)[kept]
    slopes = slopes[np.isfinite(slopes).all(axis=1)]
    information = np.asarray(slopes.T @ slopes, np.float64) + 1e-12 * np.eye(4)
    return np.asarray(np.linalg.inv(information), np.float64), int(kept.sum())
