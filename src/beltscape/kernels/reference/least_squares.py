"""The references of the kernels of least squares: planes around every pixel, and Gauss-Newton equations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.kernels.images import WarpInput
from beltscape.kernels.least_squares import MOST_DISAGREEMENT, FitWindow, LocalFitInput, NormalEquationsInput
from beltscape.kernels.reference.images import warp

SLOPE_RIDGE = 0.1
"""px²: ridge that draws slopes to the earlier ones, per weight of the window. On a quarter-size heap half and double
of it change the share within 0.25 mm by 0.05 %, gross errors by 0.02 %."""
NO_WEIGHT = 1e-12
"""A window without more weight is left out: in single precision its sums are rounding errors."""
LEAST_VARIANCE = 1e-12
"""px²: lower bound of the variance that divides a squared difference, against division by zero."""
LARGEST_STEP = 1.0
"""The largest change of s, px; on a quarter-size heap half and double change the share within 0.25 mm by 0.04 %."""


@dataclass(frozen=True, slots=True, eq=False)
class _Plane:
    """One window's fit, each (H, W)."""

    change: Array
    slope_u: Array
    slope_v: Array
    variance: Array


def local_fit(given: LocalFitInput) -> tuple[NDArray[Any], ...]:
    """Return the fields of LocalFit, (H, W) each."""
    fits = [_fit_window(given, window) for window in given.windows]
    taken, scale = _largest_consistent(fits, given.confidence_width)
    missing = ~np.isfinite(given.s)
    moved = given.s + np.clip(taken.change, -LARGEST_STEP, LARGEST_STEP)
    fitted = moved, taken.slope_u, taken.slope_v, taken.variance, _disagreement(fits)
    planes = (np.where(missing, np.nan, a) for a in fitted)
    return *planes, np.where(missing, 0, scale).astype(np.uint8)


def _largest_consistent(planes: list[_Plane], width: float) -> tuple[_Plane, NDArray[np.int64]]:
    """Return per pixel the last plane up to which all confidence intervals have a value in common, and its number."""
    halves = [width * np.sqrt(plane.variance) for plane in planes]
    low = np.maximum.accumulate([plane.change - half for plane, half in zip(planes, halves, strict=True)])
    high = np.minimum.accumulate([plane.change + half for plane, half in zip(planes, halves, strict=True)])
    scale = np.maximum((low <= high).sum(axis=0) - 1, 0)  # once apart, always apart
    fields = (np.stack([getattr(plane, name) for plane in planes]) for name in _Plane.__slots__)
    return _Plane(*(np.take_along_axis(field, scale[None], axis=0)[0] for field in fields)), scale


def _disagreement(planes: list[_Plane]) -> Array:
    """Return (H, W) the disagreement of the two largest windows."""
    if len(planes) == 1:
        return np.zeros_like(planes[0].change)
    smaller, larger = planes[-2:]
    apart = larger.change - smaller.change
    return np.minimum(apart**2 / np.maximum(smaller.variance, LEAST_VARIANCE), MOST_DISAGREEMENT)


def _fit_window(given: LocalFitInput, window: FitWindow) -> _Plane:
    """Return the weighted least squares of one window, with all its taps at once."""
    information, pull, s, slope_u, slope_v = (np.asarray(field, np.float64) for field in given[:5])
    there, known = np.isfinite(s), np.isfinite(information) & np.isfinite(pull)
    information, pull = np.where(known, information, 0), np.where(known, pull, 0)
    slope_u, slope_v = (np.where(np.isnan(slope), 0, slope) for slope in (slope_u, slope_v))
    offsets = [(v, u) for v in range(-window.radius, window.radius + 1)
               for u in range(-window.reach[abs(v)], window.reach[abs(v)] + 1)]  # fmt: skip
    near = [
        _neighbours(np.where(there, f, 0), offsets) for f in (s, information + given.prior_information, pull)
    ]
    near_s, near_information, near_pull = near
    v, u = np.array(offsets, np.float64)[:, :, None, None].swapaxes(0, 1)
    above = near_s - np.where(np.isfinite(s), s, 0)
    e = above - slope_u * u - slope_v * v
    taps = np.array([window.taps[abs(v)] * window.taps[abs(u)] for v, u in offsets])[:, None, None]
    closeness = taps * np.maximum(1 - (e / given.tolerance) ** 2, 0) ** 2 * _neighbours(there, offsets)
    target = above - (1 - given.flatten) * e
    weight, pulled = closeness * near_information, closeness * (near_information * target + near_pull)
    return _solved(weight, pulled, closeness * weight, u, v, slope_u, slope_v)


def _neighbours(field: NDArray[np.float64], offsets: list[tuple[int, int]]) -> NDArray[np.float64]:
    """Return (taps, H, W) the field at every offset (v, u) from each pixel; 0 beyond the image."""
    margin = max(max(abs(v), abs(u)) for v, u in offsets)
    padded, (height, width) = np.pad(field, margin), field.shape
    return np.stack(
        [padded[margin + v : margin + v + height, margin + u : margin + u + width] for v, u in offsets]
    )


def _solved(
    weight: Array, pulled: Array, square: Array, u: Array, v: Array, slope_u: Array, slope_v: Array
) -> _Plane:
    """Minimise Σ weight (target - change - slope · (u, v))² + SLOPE_RIDGE Σ weight |slope - earlier slope|².

    ``pulled`` is weight · target, ``square`` weight² / information. The variance is that of the weighted mean,
    the neighbours having 1 / information, and that of the plane's tilt from their centre of mass to the pixel.
    """
    total = weight.sum(axis=0)
    nothing = total <= NO_WEIGHT
    total = np.where(nothing, 1, total)
    mean_u, mean_v, mean = ((a).sum(axis=0) / total for a in (weight * u, weight * v, pulled))
    du, dv = u - mean_u, v - mean_v
    uu = (weight * du**2).sum(axis=0) + SLOPE_RIDGE * total
    vv = (weight * dv**2).sum(axis=0) + SLOPE_RIDGE * total
    uv = (weight * du * dv).sum(axis=0)
    right_u = (pulled * du).sum(axis=0) + SLOPE_RIDGE * total * slope_u
    right_v = (pulled * dv).sum(axis=0) + SLOPE_RIDGE * total * slope_v
    determinant = uu * vv - uv**2
    new_u, new_v = (vv * right_u - uv * right_v) / determinant, (uu * right_v - uv * right_u) / determinant
    tilt = (vv * mean_u**2 - 2 * uv * mean_u * mean_v + uu * mean_v**2) / determinant
    return _Plane(
        np.where(nothing, 0, mean - new_u * mean_u - new_v * mean_v),
        np.where(nothing, slope_u, new_u),
        np.where(nothing, slope_v, new_v),
        np.where(nothing, np.inf, square.sum(axis=0) / total**2 + tilt),
    )


def normal_equations(
    given: NormalEquationsInput,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]:
    """Return information, pull and the number of used views, (H, W) each."""
    grey = np.asarray(given.core, np.float64)
    information, pull, used = np.zeros(grey.shape), np.zeros(grey.shape), np.zeros(grey.shape, np.uint8)
    for view, image in zip(given.views, given.coefficients, strict=True):
        value, slope = warp(WarpInput(given.s, view, image))
        seen = np.isfinite(value) & np.isfinite(grey)
        weight, normal_slope, residual, misfit = _compared(given, grey, np.where(seen, value, grey), slope)
        information += np.where(seen, weight * normal_slope**2, 0)
        pull += np.where(seen, weight * normal_slope * residual, 0)
        used += seen & (misfit < given.gate)
    return information, pull, used


def _compared(
    given: NormalEquationsInput, core: Array, view: Array, slope: Array
) -> tuple[Array, Array, Array, Array]:
    """Return weight, dn/ds, residual and misfit q (each (H, W)) of a view's warp against the core."""
    core_normal, core_scale = _normalised(core, given.window, given.floor)
    view_normal, view_scale = _normalised(view, given.window, given.floor)
    residual = core_normal - view_normal
    variance = given.noise_variance * (core_scale**2 + view_scale**2) + given.model_variance
    misfit = _box_mean(residual**2 / variance, given.residual_window)
    return 1 / (variance * (1 + (misfit / given.gate) ** 2)), slope * view_scale, residual, misfit


def _normalised(image: Array, radius: int, floor: float) -> tuple[Array, Array]:
    """Return (value - mean) scale, and the scale 1 / √(variance + floor)."""
    mean = _box_mean(image, radius)
    scale = 1 / np.sqrt(np.maximum(_box_mean(image**2, radius) - mean**2, 0) + floor)
    return (image - mean) * scale, scale


def _box_mean(image: Array, radius: int) -> Array:
    """Return the mean of the (2 radius + 1)² pixels about each that are not NaN; 0 where there are none."""
    padded = np.pad(image, radius, mode="edge")
    windows = sliding_window_view(padded, (2 * radius + 1, 2 * radius + 1))
    there = np.isfinite(windows)
    return np.where(there, windows, 0).sum(axis=(2, 3)) / np.maximum(there.sum(axis=(2, 3)), 1)
