"""What is known of the matcher and the image, in px of an image as wide as the paper's, halved."""

from __future__ import annotations

import numpy as np

from beltscape.core.camera import Camera

MATCHER_REACH_PX = 7.0
"""Beside a step the matcher's windows mix both sides up to here."""
_WIDTH_PX = 1224


def scale_of(camera: Camera) -> float:
    """How much larger than that the image is: the matcher's windows grow with it."""
    return scale_of_width(camera.size_px[0])


def scale_of_width(width_px: int) -> float:
    """Return the same for a grid of this width."""
    return float(np.clip(width_px / _WIDTH_PX, 0.5, 1.8))
