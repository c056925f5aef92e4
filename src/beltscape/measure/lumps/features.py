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
FEATURE_COUNT = 3 * len(_SCALES) + 2 * len(_CHORDS) + 6 * len(_HORIZONS) + 3
"""Numbers per cell."""

Plane = NDArray[np.float32]


def compute_features(height_px: Plane, measured: NDArray[np.bool_]) -> Plane:
    """Return features (R, C, FEATURE_COUNT) float32 from heights (R, C) without holes and the measured cells."""
    filtered = np.asarray(cv2.medianBlur(height_px, 3), np.float32)
    planes_of_features = [plane for scale in _SCALES for plane in _compute_curvature(filtered, scale)]
    planes_of_features += _compute_openness(blur(filtered, 0.8))
    missing = (~measured).astype(np.float32)
    planes_of_features += [blur(missing, 1.5), blur(missing, 5.0)]
    planes_of_features.append(_compress(5 * blur(np.abs(filtered - blur(filtered, 1.0)), 3.0)))
    return np.stack(planes_of_features, axis=-1)


def _compress(values: NDArray[np.floating]) -> Plane:
    """Return values compressed to -1..1, so that the size of large values does not matter."""
    return np.asarray(values / np.sqrt(1 + values * values), np.float32)


def _compute_curvature(height: Plane, scale: float) -> list[Plane]:
    """Return the larger and the smaller principal second derivative and the slope, smoothed at a scale."""
    smooth = np.pad(blur(height, scale), 1, mode="edge")
    middle = smooth[1:-1, 1:-1]
    right, left, below, above = smooth[1:-1, 2:], smooth[1:-1, :-2], smooth[2:, 1:-1], smooth[:-2, 1:-1]
    xx, yy = right + left - 2 * middle, below + above - 2 * middle
    xy = (smooth[2:, 2:] + smooth[:-2, :-2] - smooth[2:, :-2] - smooth[:-2, 2:]) / 4
    mean, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    factor = np.float32(1.5 * scale)
    slope = np.hypot(right - left, below - above) / 2
    return [_compress((mean + spread) * factor), _compress((mean - spread) * factor), _compress(slope)]


def _compute_openness(height: Plane) -> list[Plane]:
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
    planes_of_features: list[Plane] = []
    for planes in chords.values():
        planes_of_features += [_compress(_compute_maximum(planes)), _compress(_compute_minimum(planes))]
    for step in _HORIZONS:
        for planes in (rises[step], falls[step]):
            mean = sum(planes[1:], planes[0]) / np.float32(len(planes))
            planes_of_features += [
                _compress(_compute_maximum(planes)),
                _compress(mean),
                _compress(_compute_minimum(planes)),
            ]
    return planes_of_features


def _compute_maximum(planes: Sequence[Plane]) -> Plane:
    return np.maximum(np.maximum(planes[0], planes[1]), np.maximum(planes[2], planes[3]))


def _compute_minimum(planes: Sequence[Plane]) -> Plane:
    return np.minimum(np.minimum(planes[0], planes[1]), np.minimum(planes[2], planes[3]))
