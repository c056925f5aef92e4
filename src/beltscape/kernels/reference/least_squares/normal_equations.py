"""Gauss-Newton equations for a change of inverse depth: the reference of `normal_equations`."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from beltscape.kernels.images.warping import WarpInput
from beltscape.kernels.least_squares.normal_equations import NormalEquationsInput
from beltscape.kernels.reference.images.warping import warp

Array = NDArray[np.float64]


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
