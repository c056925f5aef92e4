"""How uncertain the mean over the pairs is, from what the pairs themselves say."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.fusion import Fused

_WINDOW_PX = 15
_PAIR_SIGMA_PX = 0.12
"""One pair's disparity error where there is nothing to learn from: SGBM's pixel locking and matching noise."""
_PRIOR_WEIGHT = 10.0
"""How many degrees of freedom that knowledge counts for."""
_SHARED_SIGMA_PX = 0.03
"""The part that all pairs share and that no mean takes away."""


def depth_sigma(fused: Fused, scale_mm_px: float) -> NDArray[np.float32]:
    """(H, W) float32 standard deviation of the mean depth, mm; NaN where there is none.

    The variance between the pairs, in px of disparity and pooled over a window, is divided by the number of
    pairs in the mean; what all pairs have in common is added.

    Parameters
    ----------
    fused
        The mean over the pairs.
    scale_mm_px
        Focal length times baseline (mean over the pairs), px·mm: a disparity error e makes e·Z²/scale of depth.
    """
    depth = fused.depth_mm
    measured = fused.views > 0
    mm_per_px = np.where(measured, depth, 1.0) ** 2 / np.float32(scale_mm_px)
    scatter_px2 = fused.scatter_mm2 / mm_per_px**2
    freedom = np.where(measured, fused.views.astype(np.float32) - 1.0, 0.0).astype(np.float32)
    window = (_WINDOW_PX, _WINDOW_PX)
    pooled = cv2.boxFilter(np.where(measured, scatter_px2, 0).astype(np.float32), -1, window, normalize=False)
    total = cv2.boxFilter(freedom, -1, window, normalize=False)
    pair = (_PRIOR_WEIGHT * _PAIR_SIGMA_PX**2 + pooled) / (_PRIOR_WEIGHT + total)
    variance = pair / np.maximum(fused.views, 1) + _SHARED_SIGMA_PX**2
    return np.where(measured, np.sqrt(variance) * mm_per_px, np.nan).astype(np.float32)
