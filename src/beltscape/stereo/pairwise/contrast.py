"""Equalisation of local contrast before matching, since the brightness of two cameras differs."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image, to_grey

_FLOOR = 0.2
"""Contrast of the square root of 8-bit counts that noise causes: shot and read noise of a few counts."""
_GAIN = 25.0
"""Counts per unit of contrast, so that SGBM's gradient cap hardly clips."""


def take_square_root(image: Image) -> NDArray[np.float32]:
    """Return the (H, W) float32 square root of the luminance in 8-bit counts, whose noise is uniform."""
    counts = to_grey(image) * np.float32(255.0 / np.iinfo(image.dtype).max)
    return np.sqrt(counts + np.float32(1.0))


def equalise_contrast(root: NDArray[np.float32], radius_px: float) -> NDArray[np.uint8]:
    """Return (H, W) uint8 levels of local mean 128 and equal local contrast over a Gaussian neighbourhood."""
    mean = cv2.GaussianBlur(root, (0, 0), radius_px)
    variance = cv2.GaussianBlur(root * root, (0, 0), radius_px) - mean * mean
    scale = _GAIN / (np.sqrt(np.maximum(variance, 0)) + _FLOOR)
    return np.clip(128.5 + scale * (root - mean), 0, 255).astype(np.uint8)


def quantise_root(image: Image) -> NDArray[np.uint8]:
    """Return the (H, W) uint8 square root of the counts, stretched to the full range."""
    root = take_square_root(image)
    return np.rint(np.clip(root * (255 / max(float(root.max()), 1e-6)), 0, 255)).astype(np.uint8)
