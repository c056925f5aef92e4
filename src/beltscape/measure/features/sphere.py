"""A sphere fitted to its visible cap, corrected for the smoothing by the matcher's windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.measure.features.face import compute_rays
from beltscape.measure.features.smoothing import Smoothing, compute_camera_scale

_OFF_MM, _MIN_SHARE = 4.0, 0.3
"""A sphere counts as absent if less than this share of its pixels lies within this distance of the nominal one."""


@dataclass(frozen=True, slots=True, eq=False)
class Cap:
    """A window (h, w) of the depth map around a sphere."""

    window: tuple[slice, slice]
    rays: NDArray[np.float64]
    """(h, w, 3)."""
    depth_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    information: NDArray[np.float64]
    """Information of each pixel about its own depth; 1 without an image."""
    on_sphere: NDArray[np.bool_]
    """Pixels of the sphere's nominal view."""
    valid: NDArray[np.bool_]
    """Those of them that are measured, away from missing ones."""


def crop_cap(
    depth: DepthMap,
    camera: Camera,
    sphere_mask: NDArray[np.bool_],
    center_mm: NDArray[np.float64],
    radius_mm: float,
    smoothing: Smoothing | None,
) -> Cap:
    """Return the window of the depth map around a nominal sphere."""
    window = _project_window(camera, center_mm, radius_mm, 1 if smoothing is None else smoothing.step)
    z, sigma = (values[window].astype(np.float64) for values in (depth.depth_mm, depth.sigma_mm))
    information = np.ones_like(z) if smoothing is None else smoothing.expand_information(window)
    on_sphere = sphere_mask[window].astype(np.float64) > 0
    valid = on_sphere & (np.asarray(ndimage.distance_transform_edt(np.isfinite(z))) > 2)
    return Cap(window, compute_rays(camera, *np.mgrid[window]), z, sigma, information, on_sphere, valid)


def is_present(cap: Cap, nominal: NDArray[np.float64]) -> bool:
    """Decide whether enough pixels of a sphere's nominal view lie near the nominal sphere (centre, radius)."""
    if not cap.on_sphere.any():
        return False
    near = np.abs(cap.depth_mm - compute_sphere_depth_mm(nominal, cap.rays))[cap.on_sphere] < _OFF_MM
    return bool(np.mean(near) >= _MIN_SHARE)


def _project_window(
    camera: Camera, center_mm: NDArray[np.float64], radius_mm: float, step: int
) -> tuple[slice, slice]:
    """Return the rows and columns around a sphere, in whole blocks of ``step`` pixels."""
    reach = 1.3 * radius_mm * float(camera.focal_px.max()) / center_mm[2] + 8
    middle = center_mm[:2] / center_mm[2] * camera.focal_px + camera.center_px
    low, high = np.maximum(middle - reach, 0).astype(int), np.minimum(middle + reach + 1, camera.size_px)
    low, high = low // step * step, np.maximum(high.astype(int), low) // step * step
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def compute_sphere_depth_mm(sphere: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the depth (...) of the near side of a sphere (centre, radius) on rays (..., 3); NaN beside it."""
    center, radius = sphere[:3], sphere[3]
    a, b = np.sum(rays**2, axis=-1), rays @ center
    with np.errstate(invalid="ignore"):
        return (b - np.sqrt(b * b - a * (center @ center - radius**2))) / a


def compute_incidence_deg(
    sphere: NDArray[np.float64], rays: NDArray[np.float64], depth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the angle of incidence (...), degrees; 90 beside the sphere."""
    normal = (rays * depth[..., None] - sphere[:3]) / sphere[3]
    cosine = -np.sum(normal * rays, axis=-1) / np.linalg.norm(rays, axis=-1)
    return np.rad2deg(np.arccos(np.clip(np.nan_to_num(cosine), 0, 1)))


_CAP_DEG = 58.0
"""Largest angle of incidence: beyond it a surface is measured badly, and at the limb not at all."""
_MIN_PIXELS = 60
"""Least number of pixels of a sphere."""
_MIN_DEPTH_SIGMA_MM, _MIN_RADIUS_SIGMA_MM = 0.02, 0.002
"""Lower limits of σ of a depth and of a radius."""
_PATCH_PX = 12.0
"""Side of a square within which errors may be correlated: the matcher's windows, or a dot with its neighbourhood."""
_FEW_PATCHES = 1.3
"""Factor on σ from some ten patches, which is too small by this (24 simulated spheres)."""
_ANGLE_DEG = 10.0
"""Width of the classes of incidence in which the scatter is computed."""
_TOP_DEG = 20.0
"""Angle of incidence up to which pixels belong to the top of a sphere."""
_UNTWICED = 0.9
"""Ratio of σ to the flattening at the top: 0.5 to 0.7 with ``standard``, 1.08 and more with ``fast`` (15 spheres)."""
_ROUNDS = 4
"""Rounds of fit and rejection."""
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


@dataclass(frozen=True, slots=True, eq=False)
class _DepthBias:
    """The error that the matcher's smoothing adds to the depth of the cap, each array (h, w) in mm."""

    corrected_mm: NDArray[np.float64]
    """The part that is subtracted."""
    flattening_mm: NDArray[np.float64]
    """The full flattening by the windows, without twicing."""


@dataclass(frozen=True, slots=True, eq=False)
class _CapFit:
    """A sphere fitted to a cap."""

    sphere: NDArray[np.float64]
    """(4,) centre and radius, mm."""
    bias: _DepthBias
    incidence_deg: NDArray[np.float64]
    """(h, w) angles of incidence."""
    used: NDArray[np.bool_]
    """(h, w) pixels of the fit."""
    weight: NDArray[np.float64]
    """(N,) weights of the used pixels."""


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
    cap = crop_cap(depth, camera, sphere_mask, center_mm, radius_mm, smoothing)
    nominal = np.append(center_mm, radius_mm)
    if not is_present(cap, nominal):
        return None
    fit = _fit_cap(cap, nominal, smoothing)
    if fit is None:
        return None
    scale = compute_camera_scale(camera)
    linear = _linearise(cap, fit, _number_patches(cap.depth_mm.shape, scale))
    if smoothing is None:
        pixel_mm = center_mm[2] / float(camera.focal_px.mean())
        systematic_mm = (_SMOOTHED_PX * scale * pixel_mm) ** 2 / radius_mm
    else:
        fading_mm = _compute_fading_error_mm(cap, fit, smoothing)
        systematic_mm = float(np.hypot(_MODEL_ERROR * linear.change[3, 0], fading_mm * linear.change[3, 1]))
    variance = _FEW_PATCHES**2 * linear.covariance[3, 3] + systematic_mm**2 + _MIN_RADIUS_SIGMA_MM**2
    corrected_mm = float(np.mean(fit.bias.corrected_mm[fit.used]))
    return FittedSphere(
        fit.sphere[:3], float(fit.sphere[3]), float(np.sqrt(variance)), linear.points, corrected_mm
    )


def _fit_cap(cap: Cap, nominal: NDArray[np.float64], smoothing: Smoothing | None) -> _CapFit | None:
    """Fit sphere and depth bias in turns, from the nominal sphere; return None where too few pixels are usable."""
    z, sphere, radius_mm = cap.depth_mm, nominal, float(nominal[3])
    bias, fit = _DepthBias(np.zeros_like(z), np.zeros_like(z)), None
    for round_number in range(_ROUNDS):
        model = compute_sphere_depth_mm(sphere, cap.rays)
        incidence = compute_incidence_deg(sphere, cap.rays, model)
        if smoothing is not None and round_number:
            bias = _compute_bias(cap, model, incidence, smoothing)
        used = cap.valid & (incidence < _CAP_DEG) & np.isfinite(bias.corrected_mm)
        used &= np.abs(z - model) < 0.3 * radius_mm
        if used.sum() < _MIN_PIXELS:
            return None
        weight = _compute_weight(cap.information[used], incidence[used], cap.sigma_mm[used])
        sphere = _fit_parameters(sphere, cap.rays[used], (z - bias.corrected_mm)[used], weight, radius_mm)
        fit = _CapFit(sphere, bias, incidence, used, weight)
    return fit


def _compute_bias(
    cap: Cap, model: NDArray[np.float64], incidence_deg: NDArray[np.float64], smoothing: Smoothing
) -> _DepthBias:
    """Return the bias by the smoothing of a sphere's depth ``model`` (h, w); zero where the map is not smoothed."""
    zero = np.zeros_like(model)
    corrected = smoothing.smooth(model, cap.window) - model if smoothing.passes.twicing else zero
    flattening = smoothing.without_twicing().smooth(model, cap.window) - model
    compared = cap.valid & np.isfinite(flattening) & (incidence_deg < _CAP_DEG)
    if not _is_smoothed((cap.depth_mm - model)[compared], flattening[compared]):
        return _DepthBias(zero, zero)
    return _DepthBias(corrected, flattening)


def _compute_weight(
    information: NDArray[np.float64], incidence_deg: NDArray[np.float64], sigma_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return weights (N,); on an image without texture on most of the cap, the information of all pixels is alike."""
    if np.median(information) <= 0:
        information = np.ones_like(information)
    return information / _compute_sigma_by_angle(incidence_deg, sigma_mm) ** 2


def _compute_fading_error_mm(cap: Cap, fit: _CapFit, smoothing: Smoothing) -> float:
    """Return the error of the sphere's top, mm, that may fade towards the limb.

    A map without twicing, or one whose σ exceeds the flattening, comes from ``fast``, which flattens tops and fattens
    limbs by amounts that the model of its windows does not give: there σ and the flattening count fully.
    """
    flattening_mm = fit.bias.flattening_mm
    top = cap.valid & (fit.incidence_deg < _TOP_DEG) & np.isfinite(flattening_mm)
    if not top.any():
        return 0.0
    noise, flat = float(np.median(cap.sigma_mm[top])), float(np.median(flattening_mm[top]))
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
    spread = MAD_TO_SIGMA * float(np.median(np.abs((z - compute_sphere_depth_mm(start, rays)) * root))) + 1e-4

    def residual(sphere: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.nan_to_num(z - compute_sphere_depth_mm(sphere, rays), nan=nominal_mm) * root / spread

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
    """(4, 2) mm change of the parameters by a depth error as large as the flattening, and by one that fades."""
    points: int
    """Pixels that the fit did not reject."""


def _linearise(cap: Cap, fit: _CapFit, patches: NDArray[np.intp]) -> _LinearisedFit:
    """Linearise a fit at its solution, for errors as large as the flattening, and ones that fade towards the limb.

    The covariance is that of errors which are correlated within ``patches`` (h, w) in any way (cluster-robust: Liang
    & Zeger, Biometrika 73(1), 1986, doi:10.1093/biomet/73.1.13).
    """
    sphere, rays, patches = fit.sphere, cap.rays[fit.used], patches[fit.used]
    error = np.stack([fit.bias.flattening_mm, 1 - fit.incidence_deg / _CAP_DEG], -1)[fit.used]
    root = np.sqrt(fit.weight / np.median(fit.weight))
    residual = (
        (cap.depth_mm - fit.bias.corrected_mm)[fit.used] - compute_sphere_depth_mm(sphere, rays)
    ) * root
    limit = 4 * MAD_TO_SIGMA * float(np.nanmedian(np.abs(residual))) + 1e-6
    steps = 1e-4 * np.eye(4)
    slopes = np.stack(
        [
            (compute_sphere_depth_mm(sphere + d, rays) - compute_sphere_depth_mm(sphere - d, rays)) / 2e-4
            for d in steps
        ],
        axis=-1,
    )
    finite = np.isfinite(residual) & np.isfinite(slopes).all(axis=1) & np.isfinite(error).all(axis=1)
    slopes, residual, error = (
        (slopes * root[:, None])[finite], residual[finite], (error * root[:, None])[finite],
    )  # fmt: skip
    inverse = np.linalg.inv(slopes.T @ slopes + 1e-12 * np.eye(4))
    scores = np.zeros((int(patches.max()) + 1, 4))
    np.add.at(scores, patches[finite], slopes * np.clip(residual, -limit, limit)[:, None])
    count = int(scores.any(axis=1).sum())
    covariance = count / max(count - 4, 1) * inverse @ (scores.T @ scores) @ inverse
    return _LinearisedFit(covariance, inverse @ (slopes.T @ error), int((np.abs(residual) < limit).sum()))


def _number_patches(shape: tuple[int, ...], scale: float) -> NDArray[np.intp]:
    """Number (h, w) the squares of a grid within which errors are correlated."""
    side = max(int(_PATCH_PX * scale), 2)
    rows, columns = np.indices(shape) // side
    return rows * (shape[1] // side + 1) + columns


def _compute_sigma_by_angle(
    incidence_deg: NDArray[np.float64], sigma: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the median σ (N,), mm, of the pixels with about the same angle of incidence (N,)."""
    bins = np.clip(incidence_deg // _ANGLE_DEG, 0, _CAP_DEG // _ANGLE_DEG).astype(np.intp)
    medians = [np.median(sigma[bins == k]) if (bins == k).any() else 1.0 for k in range(int(bins.max()) + 1)]
    return np.hypot(np.array(medians)[bins], _MIN_DEPTH_SIGMA_MM)
