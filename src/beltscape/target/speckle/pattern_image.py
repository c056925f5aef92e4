"""A pattern as an image to be projected pixel by pixel."""

from __future__ import annotations

from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from beltscape.target.speckle.disc_coverage import compute_disc_coverage
from beltscape.target.speckle.pattern import Pattern


def draw_pattern(pattern: Pattern, bits: Literal[8, 16] = 8) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return (H, W, 3) RGB of 8 or 16 bits; each pixel is the mean of the colours in it, in pixel values."""
    markers = np.array([(*marker.center_px, marker.radius_px, 1.0) for marker in pattern.markers])
    dot_coverage = np.clip(compute_disc_coverage(pattern.size_px, pattern.dots), 0, 1)
    marker_coverage = np.clip(compute_disc_coverage(pattern.size_px, markers), 0, 1)
    settings = pattern.settings
    background, dot, marker = map(
        rgb_from_hex, (settings.background, settings.dot_color, settings.marker_color)
    )
    max_value = 2**bits - 1
    image = np.empty((*dot_coverage.shape, 3), dtype=np.uint8 if bits == 8 else np.uint16)
    for channel in range(3):
        low = background[channel]
        value = low + dot_coverage * (dot[channel] - low) + marker_coverage * (marker[channel] - low)
        image[..., channel] = np.rint(np.clip(value, 0, 1) * max_value)
    return cast("NDArray[np.uint8] | NDArray[np.uint16]", image)


def rgb_from_hex(color: str) -> NDArray[np.float64]:
    """Return (3,) red, green, blue 0..1 of a colour written #RRGGBB."""
    return np.array([int(color[start : start + 2], 16) / 255 for start in (1, 3, 5)])


def hex_from_rgb(rgb: NDArray[np.float64]) -> str:
    """Return the nearest colour written #RRGGBB."""
    return "#" + "".join(f"{round(float(value) * 255):02X}" for value in rgb)
