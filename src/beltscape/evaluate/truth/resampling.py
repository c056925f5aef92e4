"""Resampling of the truth to the grid of another core camera, for depth measured with a calibrated rig."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.rig import Rig

_STEP = 0.006
"""Relative depth range within 2 × 2 pixels above which there is a step, and no interpolation: 4 mm at 0.7 m."""


def resample_depth(rig: Rig, truth: Rig, true_mm: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the true depth on the grid of a calibrated core camera, mm; NaN outside the truth.

    ``true_mm`` is (H, W) on the true core's undistorted grid, both cores being the same camera. Inverse depth,
    which is linear on a plane, is interpolated bilinearly; at steps the nearest pixel is taken.
    """
    u, v = _true_pixels(rig, truth)
    height, width = true_mm.shape
    inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    left, top = (np.floor(x).astype(np.intp).clip(0, n - 2) for x, n in ((u, width), (v, height)))
    corners = np.stack([true_mm[top + j, left + i] for j in (0, 1) for i in (0, 1)]).astype(np.float64)
    a, b = u - left, v - top
    weights = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
    nearest = np.take_along_axis(corners, weights.argmax(axis=0)[None], axis=0)[0]
    smooth = np.asarray(np.ptp(corners, axis=0) < _STEP * nearest, bool)  # false with a NaN, too
    mixed: NDArray[np.float64] = 1 / (weights / corners).sum(axis=0)
    return np.where(inside, np.where(smooth, mixed, nearest), np.nan)


def resample_mask(rig: Rig, truth: Rig, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask on the true core's grid resampled to a calibrated core's, (H, W); False outside."""
    u, v = (np.rint(x).astype(np.intp) for x in _true_pixels(rig, truth))
    height, width = mask.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return inside & mask[v.clip(0, height - 1), u.clip(0, width - 1)]


def _true_pixels(rig: Rig, truth: Rig) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    camera = truth.core_camera
    u, v = np.moveaxis(rig.core_camera.rays() * camera.focal_px + camera.center_px, -1, 0)
    return u, v
