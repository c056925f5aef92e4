"""What a cell sees of the shape about it: bends at several scales, and how the surface rises and falls away.

All are in cells, so they do not change with the unit of length, nor when the raster is turned or mirrored.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.measure.lumps.raster import blur

_SCALES = (1.0, 2.0, 4.0, 8.0)
_AXES = ((0, 1), (1, 0), (1, 1), (1, -1))
_STEPS = (1, 2, 3, 4, 6, 8, 12, 16, 24)
_CHORDS = (2, 4, 8, 16)
_HORIZONS = (8, 24)
FEATURES = 3 * len(_SCALES) + 2 * len(_CHORDS) + 6 * len(_HORIZONS) + 3
"""Numbers per cell."""

Plane = NDArray[np.float32]


def features(height_px: Plane, measured: NDArray[np.bool_]) -> Plane:
    """(R, C, FEATURES) float32 of heights (R, C) without holes and where they were truly measured."""
    calm = np.asarray(cv2.medianBlur(height_px, 3), np.float32)
    found = [plane for scale in _SCALES for plane in _bends(calm, scale)]
    found += _horizon(blur(calm, 0.8))
    missing = (~measured).astype(np.float32)
    found += [blur(missing, 1.5), blur(missing, 5.0)]
    found.append(_bounded(5 * blur(np.abs(calm - blur(calm, 1.0)), 3.0)))
    return np.stack(found, axis=-1)


def _bounded(values: Plane) -> Plane:
    """Between -1 and 1: how large a large value is does not matter."""
    return np.asarray(values / np.sqrt(1 + values * values), np.float32)


def _bends(height: Plane, scale: float) -> list[Plane]:
    """The larger and the smaller principal second derivative and the slope, smoothed at a scale."""
    smooth = np.pad(blur(height, scale), 1, mode="edge")
    middle = smooth[1:-1, 1:-1]
    right, left, below, above = smooth[1:-1, 2:], smooth[1:-1, :-2], smooth[2:, 1:-1], smooth[:-2, 1:-1]
    xx, yy = right + left - 2 * middle, below + above - 2 * middle
    xy = (smooth[2:, 2:] + smooth[:-2, :-2] - smooth[2:, :-2] - smooth[:-2, 2:]) / 4
    mean, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    factor = np.float32(1.5 * scale)
    slope = np.hypot(right - left, below - above) / 2
    return [_bounded((mean + spread) * factor), _bounded((mean - spread) * factor), _bounded(slope)]


def _horizon(height: Plane) -> list[Plane]:
    """Along four axes: chords above the cell, and the steepest rise and fall that both ways have in common.

    The latter is the topographic openness of Yokoyama et al. 2002 (Photogramm. Eng. Remote Sens. 68(3)), by axis.
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
            for way, sign in enumerate((1, -1)):
                top, left = reach + sign * cells * down, reach + sign * cells * right
                slope = wide[top : top + rows, left : left + columns] - height
                slope *= np.float32(1 / (cells * length))
                np.maximum(rise[way], slope, out=rise[way])
                np.minimum(fall[way], slope, out=fall[way])
                slopes.append(slope)
            if step in chords:
                chords[step].append(slopes[0] + slopes[1])
            if step in rises:
                rises[step].append(np.minimum(*rise))
                falls[step].append(-np.maximum(*fall))
    found: list[Plane] = []
    for planes in chords.values():
        found += [_bounded(_most(planes)), _bounded(_least(planes))]
    for step in _HORIZONS:
        for planes in (rises[step], falls[step]):
            mean = sum(planes[1:], planes[0]) / np.float32(len(planes))
            found += [_bounded(_most(planes)), _bounded(mean), _bounded(_least(planes))]
    return found


def _most(planes: Sequence[Plane]) -> Plane:
    return np.maximum(np.maximum(planes[0], planes[1]), np.maximum(planes[2], planes[3]))


def _least(planes: Sequence[Plane]) -> Plane:
    return np.minimum(np.minimum(planes[0], planes[1]), np.minimum(planes[2], planes[3]))
