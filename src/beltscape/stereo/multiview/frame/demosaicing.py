"""Detection of images interpolated from a colour filter array, by their 2 × 2 pattern of sharpness.

A demosaiced image repeats, with a period of two pixels, which colour of a pixel was measured and which was
interpolated. Measured values differ more from their neighbours than interpolated ones do. The pattern survives the
conversion to grey and JPEG compression; no scene has a structure that follows the pixel grid in this way.

References
----------
Gallagher & Chen, Image authentication by detecting traces of demosaicing, CVPR Workshops 2008,
doi:10.1109/CVPRW.2008.4562984.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

_RATIO = 1.07
"""Ratio of the sharpest to the least sharp of the four pixel phases: at most 1.04 in simulated images of three
sensors or one, 1.4 and more after OpenCV's demosaicing methods, 1.1 and more after JPEG of quality 90 besides, where
dots are up to 5 px wide."""
_CHANCE = 2.0
"""Added to the ratio per root of the pixels of a phase: small images differ more by chance."""
_PIXELS = 80_000
"""Size of the band of rows that is examined."""
_CROSS = np.array([[0, -1, 0], [-1, 4, -1], [0, -1, 0]], np.float32)
"""Second difference over the four neighbours; it is smaller where a value was interpolated."""


def are_demosaiced(levels: Iterable[NDArray[np.float32]]) -> bool:
    """Return whether most of the images (H, W) show the pattern of demosaicing."""
    is_periodic = [
        compute_phase_ratio(level) > _RATIO + _CHANCE / np.sqrt(_select_middle_rows(level).size / 4)
        for level in levels
    ]
    return bool(sum(is_periodic) > len(is_periodic) / 2)


def compute_phase_ratio(level: NDArray[np.float32]) -> float:
    """Return the ratio of sharpness between the sharpest and the least sharp of the 2 × 2 pixel phases.

    The sharpness of a phase is the mean absolute difference of its pixels to their four neighbours, in the middle
    rows of the image (H, W).
    """
    band = _select_middle_rows(level)
    height, width = (side // 2 * 2 for side in band.shape)
    difference = np.abs(cv2.filter2D(band, -1, _CROSS))[:height, :width]
    sharpness = [float(difference[row::2, column::2].mean()) for row in (0, 1) for column in (0, 1)]
    return max(sharpness) / min(sharpness) if min(sharpness) > 0 else 1.0


def _select_middle_rows(level: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the middle rows (h, W) of an image (H, W)."""
    rows = max(2, _PIXELS // level.shape[1])
    start = max(0, (len(level) - rows) // 2)
    return level[start : start + rows]
