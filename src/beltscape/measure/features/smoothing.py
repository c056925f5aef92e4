"""What the matcher's windows make of a curved surface: the same local fit, applied to the model of it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.measure.features.view import WINDOW_PX

_TOLERANCES_PX = (1.0, 0.7, 0.4, 0.25)
_LEVELS_PX = 7
_NOISE_LEVELS, _FLOOR, _MODEL = 1.2 / 255, 4.0 / 255**2, 2e-3


def information(grey: NDArray[np.floating], scale: float) -> NDArray[np.float64]:
    """(H, W) 1/px²: how well each pixel of an image by itself fixes its depth, up to a common factor.

    The gradient's energy after levels were normalised in a window, over their noise, as the matcher weighs pixels:
    dots' rims count, the dark between them does not.
    """
    value = grey.astype(np.float64) / max(float(np.quantile(grey, 0.999)), 1e-9)
    side = 2 * max(round(_LEVELS_PX * scale), 1) + 1
    mean = cv2.blur(value, (side, side))
    variance = np.maximum(cv2.blur(value * value, (side, side)) - mean**2, 0) + _FLOOR
    slope_u, slope_v = (cv2.Scharr(value, cv2.CV_64F, *axes) / 32 for axes in ((1, 0), (0, 1)))
    noise = 2 * _NOISE_LEVELS**2 / variance + _MODEL
    return 2 * (slope_u**2 + slope_v**2) / variance / noise


def smoothed(
    depth_mm: NDArray[np.float64],
    weight: NDArray[np.float64],
    nearness_mm: float,
    scale: float,
    kernels: Kernels,
) -> NDArray[np.float64]:
    """(h, w) the depth that local planes, weighted by ``weight``, make of a surface ``depth_mm``, NaN beside it.

    ``nearness_mm`` is focal length (px) times baseline (mm): what the matcher's tolerances are told in.
    """
    there = np.isfinite(depth_mm)
    true = np.where(there, nearness_mm / depth_mm, np.nan).astype(np.float32)
    known = np.where(there, weight, 0).astype(np.float32)
    s, slope_u, slope_v = true, *(np.gradient(true, axis=axis).astype(np.float32) for axis in (1, 0))
    radius, sigma = WINDOW_PX
    radii = ((max(round(radius * scale), 1), sigma * scale),)
    for tolerance in _TOLERANCES_PX:
        pull = np.nan_to_num(known * (true - s)).astype(np.float32)
        fit = kernels.local_fit(known, pull, s, slope_u, slope_v, radii=radii, tolerance=tolerance, threads=1)
        s, slope_u, slope_v = fit.s, fit.slope_u, fit.slope_v
    return nearness_mm / np.asarray(s, np.float64)
