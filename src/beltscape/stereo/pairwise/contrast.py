"""Equalisation of images before matching: two cameras share local contrast, not brightness."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image, to_grey

_FLOOR = 0.2
"""Contrast of the square root of the counts (8 bit) that is taken for noise: shot and read noise of a few counts."""
_GAIN = 25.0
"""Counts per unit of contrast: as much as SGBM's clip of the gradient lets through unclipped."""


def take_square_root(image: Image) -> NDArray[np.float32]:
    """(H, W) float32 square root of the luminance in 8-bit counts.

    The root makes noise alike in dark and bright parts: a belt of a few counts beside a bright module.
    """
    counts = to_grey(image) * np.float32(255.0 / np.iinfo(image.dtype).max)
    return np.sqrt(counts + np.float32(1.0))


def equalise_contrast(root: NDArray[np.float32], radius_px: float) -> NDArray[np.uint8]:
    """(H, W) uint8: local mean 128, local contrast equal, over a Gaussian neighbourhood."""
    mean = cv2.GaussianBlur(root, (0, 0), radius_px)
    variance = cv2.GaussianBlur(root * root, (0, 0), radius_px) - mean * mean
    scale = _GAIN / (np.sqrt(np.maximum(variance, 0)) + _FLOOR)
    return np.clip(128.5 + scale * (root - mean), 0, 255).astype(np.uint8)


def quantise_root(image: Image) -> NDArray[np.uint8]:
    """(H, W) uint8: the square root of the counts, stretched to the full range."""
    root = take_square_root(image)
    return np.rint(np.clip(root * (255 / max(float(root.max()), 1e-6)), 0, 255)).astype(np.uint8)
