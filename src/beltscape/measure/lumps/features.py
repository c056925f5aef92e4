"""Features of a cell's neighbourhood for the outline network: curvature at several scales, and openness.

All lengths are in cells, so the features do not depend on the unit of length, nor on rotation by quarter turns or
mirroring of the raster.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.measure.lumps.raster import blur

_SCALES = (1.0, 2.0, 4.0, 8.0)
"""Gaussian σ, in cells, of the smoothing before the curvatures."""
_AXES = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Directions (rows, columns) of chords and horizons."""
_STEPS = (1, 2, 3, 4, 6, 8, 12, 16, 24)
"""Distances, in cells, at which heights are read along a direction."""
_CHORDS = (2, 4, 8, 16)
"""Distances at which the middle is compared with the chord."""
_HORIZONS = (8, 24)
"""Distances within which rise and fall are searched."""

Plane = NDArray[np.float32]


def compute_features(height_px: Plane, measured: NDArray[np.bool_]) -> dict[str, Plane]:
    """Return the features (R, C) by name, from heights (R, C) without holes and the measured cells."""
    filtered = np.asarray(cv2.medianBlur(height_px, 3), np.float32)
    features: dict[str, Plane] = {}
    for scale in _SCALES:
        features |= _compute_curvature(filtered, scale)
    features |= _compute_openness(blur(filtered, 0.8))
    missing = (~measured).astype(np.float32)
    features |= {f"missing within {sigma:g}": blur(missing, sigma) for sigma in (1.5, 5.0)}
    return features | {"roughness": _compress(5 * blur(np.abs(filtered - blur(filtered, 1.0)), 3.0))}


def _compress(values: NDArray[np.floating]) -> Plane:
    """Return values compressed to -1..1, so that the size of large values does not matter."""
    return np.asarray(values / np.sqrt(1 + values * values), np.float32)


def _compute_curvature(height: Plane, scale: float) -> dict[str, Plane]:
    """Return the larger and the smaller principal second derivative and the slope, smoothed at a scale."""
    smooth = np.pad(blur(height, scale), 1, mode="edge")
    middle = smooth[1:-1, 1:-1]
    right, left, below, above = smooth[1:-1, 2:], smooth[1:-1, :-2], smooth[2:, 1:-1], smooth[:-2, 1:-1]
    xx, yy = right + left - 2 * middle, below + above - 2 * middle
    xy = (smooth[2:, 2:] + smooth[:-2, :-2] - smooth[2:, :-2] - smooth[:-2, 2:]) / 4
    mean, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    factor = np.float32(1.5 * scale)
    slope = np.hypot(right - left, below - above) / 2
    return {
        f"larger curvature at {scale:g}": _compress((mean + spread) * factor),
        f"smaller curvature at {scale:g}": _compress((mean - spread) * factor),
        f"slope at {scale:g}": _compress(slope),
    }


def _compute_openness(height: Plane) -> dict[str, Plane]:
    """Return, along four axes, the height of chords over the cell, and the openness in both directions of the axis.

    Openness is the steepest rise and fall, after Yokoyama et al. 2002 (Photogramm. Eng. Remote Sens. 68(3)), by axis.
    """
    reach = max(_STEPS)
    wide = np.pad(height, reach, mode="reflect" if min(height.shape) > reach else "edge")
    rows, columns = height.shape
    chords: dict[int, list[Plane]] = {step: [] for step in _CHORDS}
    rises: dict[int, list[Plane]] = {step: [] for step in _HORIZONS}
    falls: dict[int, list[Plane]] = {step: [] for step in _HORIZONS}
    for down, right in _AXES:
        length = float(np.hypot(down, right))
        rise = [np.full(height.shape, -np.inf, np.float32) for _ in range(2)]
        fall = [np.full(height.shape, np.inf, np.float32) for _ in range(2)]
        for step in _STEPS:
            cells = max(1, round(step / length))
            slopes: list[Plane] = []
            for side, sign in enumerate((1, -1)):
                top, left = reach + sign * cells * down, reach + sign * cells * right
                slope = wide[top : top + rows, left : left + columns] - height
                slope *= np.float32(1 / (cells * length))
                np.maximum(rise[side], slope, out=rise[side])
                np.minimum(fall[side], slope, out=fall[side])
                slopes.append(slope)
            if step in chords:
                chords[step].append(slopes[0] + slopes[1])
            if step in rises:
                rises[step].append(np.minimum(*rise))
                falls[step].append(-np.maximum(*fall))
    features: dict[str, Plane] = {}
    for step, planes in chords.items():
        features[f"highest chord over {step}"] = _compress(_compute_maximum(planes))
        features[f"lowest chord over {step}"] = _compress(_compute_minimum(planes))
    for step in _HORIZONS:
        for name, planes in (("rise", rises[step]), ("fall", falls[step])):
            mean = sum(planes[1:], planes[0]) / np.float32(len(planes))
            features[f"greatest {name} within {step}"] = _compress(_compute_maximum(planes))
            features[f"mean {name} within {step}"] = _compress(mean)
            features[f"least {name} within {step}"] = _compress(_compute_minimum(planes))
    return features


def _compute_maximum(planes: Sequence[Plane]) -> Plane:
    return np.maximum(np.maximum(planes[0], planes[1]), np.maximum(planes[2], planes[3]))


def _compute_minimum(planes: Sequence[Plane]) -> Plane:
    return np.minimum(np.minimum(planes[0], planes[1]), np.minimum(planes[2], planes[3]))
