"""Unit normals of a depth map's surface."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

_WINDOW_PX = 5
"""Side of the window in which the slopes are fitted."""
_STEP = 0.01
"""Relative difference of neighbouring depths beyond which they lie on different surfaces."""
_REACH_PX = _WINDOW_PX // 2 + 1
"""Number of rows above and below its own on which a normal depends."""


def compute_normals(
    depth_mm: NDArray[np.float32],
    rows: slice,
    rays: tuple[NDArray[np.float32], NDArray[np.float32]],
    focal_px: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Return (rows, W, 3) float32 unit normals towards the camera; NaN where the window determines no plane.

    With w = 1/Z a plane is linear in the pixel, w = a·x + b·y + c with rays (x, y, 1), and its normal is
    (a, b, c), so the gradient of w over the measured pixels of a window determines it without bias.

    Parameters
    ----------
    depth_mm
        (H, W) float32, NaN = not measured.
    rows
        Rows to compute, with start and stop.
    rays
        (W,) x/z of the columns and (H,) y/z of the rows.
    focal_px
        (2,) fx, fy.
    """
    around = slice(max(rows.start - _REACH_PX, 0), rows.stop + _REACH_PX)
    own = slice(rows.start - around.start, rows.stop - around.start)
    x, y = rays[0], rays[1][rows, None]
    fx, fy = focal_px.astype(np.float32)
    with np.errstate(invalid="ignore"):
        inverse = cast("NDArray[np.float32]", 1 / depth_mm[around])
        a = fx * _gradient(inverse, axis=1)[own]
        b = fy * _gradient(inverse, axis=0)[own]
        c = inverse[own] - a * x - b * y
        scale = -1 / np.sqrt(a * a + b * b + c * c)
    return np.asarray(cv2.merge([a * scale, b * scale, c * scale]), np.float32)


def _gradient(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Return the mean difference of neighbours on one surface within the window; NaN without any."""
    before = (slice(None), slice(-1)) if axis == 1 else (slice(-1), slice(None))
    step = np.zeros_like(values)
    usable = np.zeros(values.shape, np.bool_)
    step[before] = np.diff(values, axis=axis)
    usable[before] = np.abs(step[before]) < _STEP * values[before]
    step = np.where(usable, step, np.float32(0))
    window = (_WINDOW_PX - 1, _WINDOW_PX) if axis == 1 else (_WINDOW_PX, _WINDOW_PX - 1)
    # an even window of differences is centred on the pixel between the middle two
    anchor = (window[0] // 2, window[1] // 2)
    total = cv2.boxFilter(step, -1, window, anchor=anchor, normalize=False)
    count = cv2.boxFilter(usable.view(np.uint8), -1, window, anchor=anchor, normalize=False)
    return np.divide(total, count, out=np.full_like(values, np.nan), where=count > 0)
