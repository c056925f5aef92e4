"""Do corresponding points lie on one row? Measured on the images themselves, not believed."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

_HALF = 8
_REACH = 6
"""Rows searched above and below."""
_MATCH = 0.65
"""Correlation from which a match counts."""


@dataclass(frozen=True, slots=True)
class RowError:
    """How far matches in a rectified pair are off their row."""

    points: int
    """Matches it was measured on."""
    median_px: float
    """Median offset (auxiliary minus core): a tilt or a moved camera."""
    rms_px: float
    """Robust RMS (1.4826·MAD about 0): the offset and its change over the image."""


def row_error(core: NDArray[np.uint8], auxiliary: NDArray[np.uint8], disparities: int) -> RowError:
    """Row offsets of textured patches between two rectified images (H, W) uint8.

    The patches are matched by normalised correlation over ``disparities`` columns to the left and a few rows
    up and down; matches are refined to sub-pixel along the column. NaN when fewer than 10 patches match.
    """
    offsets = []
    corners = cv2.goodFeaturesToTrack(core, maxCorners=800, qualityLevel=0.02, minDistance=2 * _HALF)
    for u, v in np.empty((0, 2), int) if corners is None else np.rint(corners[:, 0]).astype(int):
        left, top = u - _HALF - disparities, v - _HALF - _REACH
        if left < 0 or top < 0 or u + _HALF >= core.shape[1] or v + _HALF + _REACH >= core.shape[0]:
            continue
        patch = core[v - _HALF : v + _HALF + 1, u - _HALF : u + _HALF + 1]
        area = auxiliary[top : v + _HALF + _REACH + 1, left : u + _HALF + 1]
        offset = _offset(cv2.matchTemplate(area, patch, cv2.TM_CCOEFF_NORMED))
        if offset is not None:
            offsets.append(offset)
    if len(offsets) < 10:
        return RowError(len(offsets), float("nan"), float("nan"))
    values = np.array(offsets)
    return RowError(len(values), float(np.median(values)), float(1.4826 * np.median(np.abs(values))))


def _offset(match: NDArray[np.float32]) -> float | None:
    """Sub-pixel row of the best match relative to the middle row, or None where it is not convincing."""
    row, column = np.unravel_index(int(np.argmax(match)), match.shape)
    if match[row, column] < _MATCH or not 0 < row < match.shape[0] - 1:
        return None
    above, best, below = (float(match[row + step, column]) for step in (-1, 0, 1))
    bend = above - 2 * best + below
    return float(row - _REACH + (0.5 * (above - below) / bend if bend < 0 else 0.0))
