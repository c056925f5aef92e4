"""A camera's last image as a small WebP picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image

MEDIA_TYPE = "image/webp"
_QUALITY = 72
"""Quality of WebP; Google's default is 75. Chosen for the size of the pictures."""


@dataclass(frozen=True, slots=True)
class Picture:
    """An encoded picture."""

    frame: str
    """Name of its frame."""
    wall_ns: int
    """System clock at its arrival."""
    data: bytes
    """WebP file."""


def convert_to_8_bit(image: Image) -> NDArray[np.uint8]:
    """Return the image in 8 bits; deeper images are shifted by the bits in use."""
    if image.dtype == np.uint8:
        return image.astype(np.uint8, copy=False)
    bits = max(int(image.max(initial=1)).bit_length(), 8)
    used = next(depth for depth in (8, 10, 12, 14, 16) if depth >= bits)
    return (image >> (used - 8)).astype(np.uint8)


def encode_thumbnail(image: Image, longest_px: int) -> bytes:
    """Return a grey or RGB image as WebP, its longer side at most ``longest_px``."""
    height, width = image.shape[:2]
    scale = min(longest_px / max(height, width), 1.0)
    size = (max(round(width * scale), 1), max(round(height * scale), 1))
    small = convert_to_8_bit(cv2.resize(image, size, interpolation=cv2.INTER_AREA) if scale < 1 else image)
    bgr = small if small.ndim == 2 else np.ascontiguousarray(small[..., ::-1])
    return cv2.imencode(".webp", bgr, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])[1].tobytes()
