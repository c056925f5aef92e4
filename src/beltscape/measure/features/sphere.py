"""A sphere from the cap that one sees, without the bias of the matcher's windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.measure.features.face import rays_at
from beltscape.measure.features.smoothing import Smoothing
from beltscape.measure.features.view import scale_of

_CAP_DEG = 58.0
"""Seen at more than this from the normal, a surface is measured badly, and towards its limb not at all."""
_LEAST = 60
_OFF_MM, _LEAST_SHARE = 4.0, 0.3
"""With less of it than this share so near to where it should be, the sphere is not there."""
_FLOOR_MM, _LEAST_MM = 0.02, 0.002
"""Of a depth whose σ is less; of a radius whose σ would be less."""
_PATCH_PX = 12.0
"""Side of a square within which errors may be correlated: the matcher's windows, or a dot with its surroundings."""
_FEW_PATCHES = 1.3
"""By which σ of some ten patches is too small (24 simulated spheres)."""
_ANGLE_DEG = 10.0
_TOP_DEG = 20.0
_UNTWICED = 1.2
"""σ over what windows flatten, about a top: up to 1.0 with ``standard``, 1.2 to 2 with ``fast`` (612 px)."""
_ROUNDS = 4
_SMOOTHED_PX = 2.3
"""Without weights the smoothing stays in, some (this)² / radius of the radius (simulated modules): then part of σ."""
_UNSURE = 0.2
"""Share of what windows flatten that may remain beyond the model of the smoothing (simulated, ⌀ 30–100 mm)."""
_SMOOTHED_SHARE = 0.05
"""Of what windows flatten: with smaller residuals a depth map was not matched by windows."""
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
    smoothing: Smoothing | None,
) -> Ball | None:
    """Fit a sphere to the measured pixels of ``shown`` (H, W); return None where too few are.

    Residuals are depths along the rays, weighted by the information of the pixels (what carries no dot was
    interpolated by the matcher) and by 1/σ² of pixels seen under the same angle: of these, the ones of small σ are
    those that the largest windows have smoothed. The matcher smooths a cap; its ``smoothing`` is applied to the
    fitted sphere, and the difference is taken off, unless the residuals are too small for a map that was matched.
    """
    step = 1 if smoothing is None else smoothing.step
    window, pixel = _window(camera, center_mm, radius_mm, step), center_mm[2] / float(camera.focal_px.mean())
    rays = rays_at(camera, *np.mgrid[window])
    z, sigma, on = (a[window].astype(np.float64) for a in (depth.depth_mm, depth.sigma_mm, shown))
    tell = np.ones_like(z) if smoothing is None else smoothing.of_pixels(window)
    sound = (on > 0) & (np.asarray(ndimage.distance_transform_edt(np.isfinite(z))) > 2)
    sphere = np.append(center_mm, radius_mm)
    there = on > 0
    if np.mean(np.abs(z - _depth(sphere, rays))[there] < _OFF_MM if there.any() else [False]) < _LEAST_SHARE:
        return None
    lean = np.full_like(z, 90.0)
    off, fit = np.zeros_like(z), _Fit(np.eye(4), np.zeros((4, 2)), 0)
    unsure, use, patches = np.zeros_like(z), sound, _patches(z.shape, scale_of(camera))
    for turn in range(_ROUNDS):
        model = _depth(sphere, rays)
        lean = _lean_deg(sphere, rays, model)
        if smoothing is not None and turn:
            off = smoothing.smooth(model, window) - model if smoothing.passes.twicing else np.zeros_like(z)
            unsure = smoothing.untwiced().smooth(model, window) - model
            there = sound & np.isfinite(unsure) & (lean < _CAP_DEG)
            if not _is_smoothed((z - model)[there], unsure[there]):
                off, unsure = np.zeros_like(z), np.zeros_like(z)
        use = sound & (lean < _CAP_DEG) & np.isfinite(off) & (np.abs(z - model) < 0.3 * radius_mm)
        if use.sum() < _LEAST:
            return None
        trust = tell[use] / _sigma_by_angle(lean[use], sigma[use]) ** 2
        sphere = _fit(sphere, rays[use], (z - off)[use], trust, radius_mm)
        fade = 1 - lean / _CAP_DEG
        fit = _linearise(
            sphere, rays[use], (z - off)[use], np.stack([unsure, fade], -1)[use], trust, patches[use]
        )
    top = sound & (lean < _TOP_DEG) & np.isfinite(unsure)
    fading = _fading_mm(sigma[top], unsure[top], smoothing)
    unknown = float(np.hypot(_UNSURE * fit.change[3, 0], fading * fit.change[3, 1]))
    if smoothing is None:
        unknown = (_SMOOTHED_PX * scale_of(camera) * pixel) ** 2 / radius_mm
    total = float(np.sqrt(_FEW_PATCHES**2 * fit.covariance[3, 3] + unknown**2 + _LEAST_MM**2))
    return Ball(
        sphere[:3],
        float(sphere[3]),
        total,
        fit.points,
        float(np.mean(off[use])),
    )


def _window(
    camera: Camera, center_mm: NDArray[np.float64], radius_mm: float, step: int
) -> tuple[slice, slice]:
    """Rows and columns about a sphere, in whole blocks of ``step`` pixels."""
    reach = 1.3 * radius_mm * float(camera.focal_px.max()) / center_mm[2] + 8
    middle = center_mm[:2] / center_mm[2] * camera.focal_px + camera.center_px
    low, high = np.maximum(middle - reach, 0).astype(int), np.minimum(middle + reach + 1, camera.size_px)
    low, high = low // step * step, np.maximum(high.astype(int), low) // step * step
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


def _fading_mm(
    sigma: NDArray[np.float64], flattened: NDArray[np.float64], smoothing: Smoothing | None
) -> float:
    """Return an error of the sphere's top, mm, that may fade towards the limb, from pixels (N,) about the top.

    A map without twicing, or one whose σ is larger than what windows flatten, is that of ``fast``: it flattens tops
    and fattens limbs by amounts that no model of its windows gives. All of it counts there.
    """
    if smoothing is None or not sigma.size:
        return 0.0
    noise, flat = float(np.median(sigma)), float(np.median(flattened))
    if smoothing.passes.twicing:
        return noise if noise > _UNTWICED * flat else max(noise - flat, 0.0)
    return max(noise, flat)


def _is_smoothed(residual: NDArray[np.float64], off: NDArray[np.float64]) -> bool:
    """Decide whether residuals (N,) are as large as smoothing makes them; those of an exact depth map are not."""
    return float(np.median(np.abs(residual))) > _SMOOTHED_SHARE * float(np.median(np.abs(off)))


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


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A sphere with what its parameters (centre, radius) owe to noise and to the smoothing."""

    covariance: NDArray[np.float64]
    """(4, 4) mm²."""
    change: NDArray[np.float64]
    """(4, K) mm by which depth errors as given move them."""
    points: int
    """Pixels that the fit did not reject."""


def _linearise(
    sphere: NDArray[np.float64],
    rays: NDArray[np.float64],
    z: NDArray[np.float64],
    error: NDArray[np.float64],
    trust: NDArray[np.float64],
    patches: NDArray[np.intp],
) -> _Fit:
    """Linearise the fit at its solution; ``error`` (N, K) mm are depth errors to be propagated.

    The covariance is that of errors which are correlated within ``patches`` (N,) in any way (cluster-robust: Liang &
    Zeger, Biometrika 73(1), 1986, doi:10.1093/biomet/73.1.13).
    """
    root = np.sqrt(trust / np.median(trust))
    left = (z - _depth(sphere, rays)) * root
    limit = 4 * 1.4826 * float(np.nanmedian(np.abs(left))) + 1e-6
    steps = 1e-4 * np.eye(4)
    slopes = np.stack([(_depth(sphere + d, rays) - _depth(sphere - d, rays)) / 2e-4 for d in steps], axis=-1)
    kept = np.isfinite(left) & np.isfinite(slopes).all(axis=1) & np.isfinite(error).all(axis=1)
    slopes, left, error = (slopes * root[:, None])[kept], left[kept], (error * root[:, None])[kept]
    inverse = np.linalg.inv(slopes.T @ slopes + 1e-12 * np.eye(4))
    scores = np.zeros((int(patches.max()) + 1, 4))
    np.add.at(scores, patches[kept], slopes * np.clip(left, -limit, limit)[:, None])
    count = int(scores.any(axis=1).sum())
    covariance = count / max(count - 4, 1) * inverse @ (scores.T @ scores) @ inverse
    return _Fit(covariance, inverse @ (slopes.T @ error), int((np.abs(left) < limit).sum()))


def _patches(shape: tuple[int, ...], scale: float) -> NDArray[np.intp]:
    """Number (h, w) the squares of a grid within which errors are correlated."""
    side = max(int(_PATCH_PX * scale), 2)
    rows, columns = np.indices(shape) // side
    return rows * (shape[1] // side + 1) + columns


def _sigma_by_angle(lean_deg: NDArray[np.float64], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N,) the median σ, mm, of the pixels that are seen under about the same angle (N,)."""
    of = np.clip(lean_deg // _ANGLE_DEG, 0, _CAP_DEG // _ANGLE_DEG).astype(np.intp)
    medians = [np.median(sigma[of == k]) if (of == k).any() else 1.0 for k in range(int(of.max()) + 1)]
    return np.hypot(np.array(medians)[of], _FLOOR_MM)
