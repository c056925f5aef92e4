"""A sphere fitted to its visible cap, corrected for the smoothing by the matcher's windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.measure.features.face import compute_rays
from beltscape.measure.features.matcher_scale import compute_camera_scale
from beltscape.measure.features.smoothing import Smoothing

_CAP_DEG = 58.0
"""Largest angle of incidence: beyond it a surface is measured badly, and at the limb not at all."""
_MIN_PIXELS = 60
_OFF_MM, _MIN_SHARE = 4.0, 0.3
"""A sphere counts as absent if less than this share of its pixels lies within this distance of the nominal one."""
_MIN_DEPTH_SIGMA_MM, _MIN_RADIUS_SIGMA_MM = 0.02, 0.002
"""Lower limits of σ of a depth and of a radius."""
_PATCH_PX = 12.0
"""Side of a square within which errors may be correlated: the matcher's windows, or a dot with its neighbourhood."""
_FEW_PATCHES = 1.3
"""Factor on σ from some ten patches, which is too small by this (24 simulated spheres)."""
_ANGLE_DEG = 10.0
_TOP_DEG = 20.0
_UNTWICED = 1.2
"""Ratio of σ to the flattening at the top, up to 1.0 with ``standard``, 1.2 to 2 with ``fast`` (612 px)."""
_ROUNDS = 4
_SMOOTHED_PX = 2.3
"""Without an image the radius is not corrected; its bias of about (this)² / radius (simulated modules) enters σ."""
_MODEL_ERROR = 0.2
"""Relative error of the modelled flattening (simulated, ⌀ 30–100 mm)."""
_SMOOTHED_SHARE = 0.05
"""With residuals below this share of the modelled flattening, the depth map was not matched by windows."""
_MAX_DEVIATION = 0.3
"""Largest relative deviation of a radius from the nominal one."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedSphere:
    """A fitted sphere."""

    center_mm: NDArray[np.float64]
    """(3,) in the core's frame."""
    radius_mm: float
    sigma_mm: float
    """One standard deviation of the radius."""
    points: int
    corrected_mm: float
    """Mean correction of the depth for the matcher's smoothing."""


def fit_sphere(
    depth: DepthMap,
    camera: Camera,
    sphere_mask: NDArray[np.bool_],
    center_mm: NDArray[np.float64],
    radius_mm: float,
    smoothing: Smoothing | None,
) -> FittedSphere | None:
    """Fit a sphere to the measured pixels of ``sphere_mask`` (H, W); return None where there are too few.

    Residuals are depths along the rays. Their weights are the information of the pixels (a pixel without a dot was
    interpolated by the matcher) times 1/σ² of all pixels of the same angle of incidence, because pixels with a small
    σ are those that the largest windows have smoothed. The matcher flattens a cap: its ``smoothing`` is applied to
    the fitted sphere and the difference subtracted, unless the residuals are too small for a matched depth map.
    """
    step = 1 if smoothing is None else smoothing.step
    window, pixel = (
        _project_window(camera, center_mm, radius_mm, step),
        center_mm[2] / float(camera.focal_px.mean()),
    )
    rays = compute_rays(camera, *np.mgrid[window])
    z, sigma, on = (a[window].astype(np.float64) for a in (depth.depth_mm, depth.sigma_mm, sphere_mask))
    information = np.ones_like(z) if smoothing is None else smoothing.expand_information(window)
    sound = (on > 0) & (np.asarray(ndimage.distance_transform_edt(np.isfinite(z))) > 2)
    sphere = np.append(center_mm, radius_mm)
    there = on > 0
    if (
        np.mean(np.abs(z - _compute_depth(sphere, rays))[there] < _OFF_MM if there.any() else [False])
        < _MIN_SHARE
    ):
        return None
    incidence = np.full_like(z, 90.0)
    correction, fit = np.zeros_like(z), _LinearisedFit(np.eye(4), np.zeros((4, 2)), 0)
    flattening, use, patches = np.zeros_like(z), sound, _number_patches(z.shape, compute_camera_scale(camera))
    for turn in range(_ROUNDS):
        model = _compute_depth(sphere, rays)
        incidence = _compute_incidence_deg(sphere, rays, model)
        if smoothing is not None and turn:
            correction = (
                smoothing.smooth(model, window) - model if smoothing.passes.twicing else np.zeros_like(z)
            )
            flattening = smoothing.without_twicing().smooth(model, window) - model
            there = sound & np.isfinite(flattening) & (incidence < _CAP_DEG)
            if not _is_smoothed((z - model)[there], flattening[there]):
                correction, flattening = np.zeros_like(z), np.zeros_like(z)
        use = sound & (incidence < _CAP_DEG) & np.isfinite(correction) & (np.abs(z - model) < 0.3 * radius_mm)
        if use.sum() < _MIN_PIXELS:
            return None
        weight = _compute_weight(information[use], incidence[use], sigma[use])
        sphere = _fit_parameters(sphere, rays[use], (z - correction)[use], weight, radius_mm)
        fade = 1 - incidence / _CAP_DEG
        fit = _linearise(
            sphere,
            rays[use],
            (z - correction)[use],
            np.stack([flattening, fade], -1)[use],
            weight,
            patches[use],
        )
    top = sound & (incidence < _TOP_DEG) & np.isfinite(flattening)
    fading = _compute_fading_error_mm(sigma[top], flattening[top], smoothing)
    systematic = float(np.hypot(_MODEL_ERROR * fit.change[3, 0], fading * fit.change[3, 1]))
    if smoothing is None:
        systematic = (_SMOOTHED_PX * compute_camera_scale(camera) * pixel) ** 2 / radius_mm
    total = float(np.sqrt(_FEW_PATCHES**2 * fit.covariance[3, 3] + systematic**2 + _MIN_RADIUS_SIGMA_MM**2))
    return FittedSphere(
        sphere[:3],
        float(sphere[3]),
        total,
        fit.points,
        float(np.mean(correction[use])),
    )


def _compute_weight(
    information: NDArray[np.float64], incidence_deg: NDArray[np.float64], sigma_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return weights (N,); on an image without texture on most of the cap, the information of all pixels is alike."""
    if np.median(information) <= 0:
        information = np.ones_like(information)
    return information / _compute_sigma_by_angle(incidence_deg, sigma_mm) ** 2


def _project_window(
    camera: Camera, center_mm: NDArray[np.float64], radius_mm: float, step: int
) -> tuple[slice, slice]:
    """Return the rows and columns around a sphere, in whole blocks of ``step`` pixels."""
    reach = 1.3 * radius_mm * float(camera.focal_px.max()) / center_mm[2] + 8
    middle = center_mm[:2] / center_mm[2] * camera.focal_px + camera.center_px
    low, high = np.maximum(middle - reach, 0).astype(int), np.minimum(middle + reach + 1, camera.size_px)
    low, high = low // step * step, np.maximum(high.astype(int), low) // step * step
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _compute_depth(sphere: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the depth (...) of the near side of a sphere (centre, radius) on rays (..., 3); NaN beside it."""
    center, radius = sphere[:3], sphere[3]
    a, b = np.sum(rays**2, axis=-1), rays @ center
    with np.errstate(invalid="ignore"):
        return (b - np.sqrt(b * b - a * (center @ center - radius**2))) / a


def _compute_incidence_deg(
    sphere: NDArray[np.float64], rays: NDArray[np.float64], depth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the angle of incidence (...), degrees; 90 beside the sphere."""
    normal = (rays * depth[..., None] - sphere[:3]) / sphere[3]
    cosine = -np.sum(normal * rays, axis=-1) / np.linalg.norm(rays, axis=-1)
    return np.rad2deg(np.arccos(np.clip(np.nan_to_num(cosine), 0, 1)))


def _compute_fading_error_mm(
    sigma: NDArray[np.float64], flattened: NDArray[np.float64], smoothing: Smoothing | None
) -> float:
    """Return the error of the sphere's top, mm, that may fade towards the limb, from pixels (N,) around the top.

    A map without twicing, or one whose σ exceeds the flattening, comes from ``fast``, which flattens tops and fattens
    limbs by amounts that the model of its windows does not give: there σ and the flattening count fully.
    """
    if smoothing is None or not sigma.size:
        return 0.0
    noise, flat = float(np.median(sigma)), float(np.median(flattened))
    if smoothing.passes.twicing:
        return noise if noise > _UNTWICED * flat else max(noise - flat, 0.0)
    return max(noise, flat)


def _is_smoothed(residual: NDArray[np.float64], correction: NDArray[np.float64]) -> bool:
    """Decide whether residuals (N,) are as large as expected after smoothing; those of an exact depth map are not."""
    return float(np.median(np.abs(residual))) > _SMOOTHED_SHARE * float(np.median(np.abs(correction)))


def _fit_parameters(
    start: NDArray[np.float64],
    rays: NDArray[np.float64],
    z: NDArray[np.float64],
    weight: NDArray[np.float64],
    nominal_mm: float,
) -> NDArray[np.float64]:
    """Return the sphere that minimises soft-L1 depth residuals over their robust spread."""
    root = np.sqrt(weight / np.median(weight))
    spread = 1.4826 * float(np.median(np.abs((z - _compute_depth(start, rays)) * root))) + 1e-4

    def residual(sphere: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.nan_to_num(z - _compute_depth(sphere, rays), nan=nominal_mm) * root / spread

    reach = np.array([nominal_mm] * 3 + [_MAX_DEVIATION * nominal_mm])
    middle = np.append(start[:3], nominal_mm)
    start = np.clip(start, middle - 0.999 * reach, middle + 0.999 * reach)
    answer = optimize.least_squares(
        residual, start, loss="soft_l1", f_scale=2.0, x_scale=0.1, bounds=(middle - reach, middle + reach)
    )
    return np.asarray(answer.x, np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _LinearisedFit:
    """The linearised fit of a sphere's parameters (centre, radius)."""

    covariance: NDArray[np.float64]
    """(4, 4) mm²."""
    change: NDArray[np.float64]
    """(4, K) mm change of the parameters by the given depth errors."""
    points: int
    """Pixels that the fit did not reject."""


def _linearise(
    sphere: NDArray[np.float64],
    rays: NDArray[np.float64],
    z: NDArray[np.float64],
    error: NDArray[np.float64],
    weight: NDArray[np.float64],
    patches: NDArray[np.intp],
) -> _LinearisedFit:
    """Linearise the fit at its solution; ``error`` (N, K) mm are depth errors to be propagated.

    The covariance is that of errors which are correlated within ``patches`` (N,) in any way (cluster-robust: Liang &
    Zeger, Biometrika 73(1), 1986, doi:10.1093/biomet/73.1.13).
    """
    root = np.sqrt(weight / np.median(weight))
    left = (z - _compute_depth(sphere, rays)) * root
    limit = 4 * 1.4826 * float(np.nanmedian(np.abs(left))) + 1e-6
    steps = 1e-4 * np.eye(4)
    slopes = np.stack(
        [(_compute_depth(sphere + d, rays) - _compute_depth(sphere - d, rays)) / 2e-4 for d in steps], axis=-1
    )
    kept = np.isfinite(left) & np.isfinite(slopes).all(axis=1) & np.isfinite(error).all(axis=1)
    slopes, left, error = (slopes * root[:, None])[kept], left[kept], (error * root[:, None])[kept]
    inverse = np.linalg.inv(slopes.T @ slopes + 1e-12 * np.eye(4))
    scores = np.zeros((int(patches.max()) + 1, 4))
    np.add.at(scores, patches[kept], slopes * np.clip(left, -limit, limit)[:, None])
    count = int(scores.any(axis=1).sum())
    covariance = count / max(count - 4, 1) * inverse @ (scores.T @ scores) @ inverse
    return _LinearisedFit(covariance, inverse @ (slopes.T @ error), int((np.abs(left) < limit).sum()))


def _number_patches(shape: tuple[int, ...], scale: float) -> NDArray[np.intp]:
    """Number (h, w) the squares of a grid within which errors are correlated."""
    side = max(int(_PATCH_PX * scale), 2)
    rows, columns = np.indices(shape) // side
    return rows * (shape[1] // side + 1) + columns


def _compute_sigma_by_angle(
    incidence_deg: NDArray[np.float64], sigma: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the median σ (N,), mm, of the pixels with about the same angle of incidence (N,)."""
    of = np.clip(incidence_deg // _ANGLE_DEG, 0, _CAP_DEG // _ANGLE_DEG).astype(np.intp)
    medians = [np.median(sigma[of == k]) if (of == k).any() else 1.0 for k in range(int(of.max()) + 1)]
    return np.hypot(np.array(medians)[of], _MIN_DEPTH_SIGMA_MM)
