"""The range of the matcher's windows beside a step, and their scale for images of any width."""

from __future__ import annotations

import numpy as np

from beltscape.core.geometry.camera import Camera

MATCHER_REACH_PX = 7.0
"""Distance from a step up to which the matcher's windows mix both sides, at the reference width."""
_WIDTH_PX = 1224
"""Reference width of the matcher's window sizes (`stereo.multiview.frame.windows`)."""


def compute_camera_scale(camera: Camera) -> float:
    """Return the scale of a camera's image over the reference width; the matcher's windows grow with it."""
    return compute_width_scale(camera.size_px[0])


def compute_width_scale(width_px: int) -> float:
    """Return the scale of a grid of this width."""
    return float(np.clip(width_px / _WIDTH_PX, 0.5, 1.8))
