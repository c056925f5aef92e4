"""Grey images of 8 bits, which OpenCV's detectors need."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image, to_grey


def convert_to_8_bit(image: Image) -> NDArray[np.uint8]:
    """Return the luminance (H, W) uint8; 16-bit images are scaled by their own brightest values."""
    luminance = to_grey(image)
    if image.dtype == np.uint16:
        luminance = luminance * (255.0 / max(float(np.quantile(luminance, 0.999)), 1.0))
    return np.clip(np.rint(luminance), 0, 255).astype(np.uint8)
