"""Standard deviation of the mean over the pairs, estimated from the pairs' scatter.

It is computed in px of rectified disparity, in which SGBM's errors do not depend on the distance.
"""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.pairwise.fusion import FusedDepth

_WINDOW_PX = 11
"""Edge of the window over which the spread between pairs is pooled."""
_FLOOR_PX = 0.09
"""Standard deviation of one pair on a smooth, well lit surface, from SGBM's pixel locking and steps of 1/16 px."""
_SHARED = 0.4
"""Share of the variance beyond the floor that is common to all pairs, because all smooth the shape."""
_SHARED_RELIEF = 0.2
"""Upper bound of the common variance over that of the relief; noise on a smooth surface is not common."""
_CORRELATION = -0.05
"""Correlation of two pairs' errors on a smooth surface; pixel locking of opposite auxiliaries has opposite signs."""
_ROUGHNESS = 0.5
"""Error of one pair per px of local relief, used where no second pair is compared."""
_PRIOR_PIXELS = 5.0
"""Weight of that error, as a number of compared pixels."""
_LOCAL_FREEDOM = 4.0
"""Weight of the neighbourhood's spread beside the pixel's own, as degrees of freedom."""
_RELIEF_RADIUS_PX = 3.0
"""Gaussian σ of the smoothing from which local relief is measured."""
_MEAN_OF_ROOT = (0.798, 0.886, 0.921, 0.940, 0.952, 0.959, 0.965)
"""E[s]/σ of a standard deviation with 1, 2, … degrees of freedom (c4)."""


def estimate_sigma(fused: FusedDepth, scale_mm_px: float) -> NDArray[np.float32]:
    """Return the (H, W) float32 standard deviation of the mean depth, mm; NaN where there is none.

    The variance between the pairs, of the neighbourhood and of the pixel, is divided by the number of pairs in the
    mean. The variance that all pairs have in common is added, since averaging does not reduce it.

    Parameters
    ----------
    fused
        The mean over the pairs.
    scale_mm_px
        Focal length times baseline (mean over the pairs), px·mm: a disparity error e makes e·Z²/scale of depth.
    """
    measured = fused.views > 0
    mm_per_px = np.where(measured, fused.depth_mm, 1.0) ** 2 / np.float32(scale_mm_px)
    scatter = np.where(measured, fused.scatter_mm2 / mm_per_px**2, 0).astype(np.float32)
    freedom = np.maximum(fused.views.astype(np.float32) - 1.0, 0.0)
    relief2 = _measure_relief(fused.depth_mm, cast("NDArray[np.float32]", mm_per_px)) ** 2
    guess = np.sqrt(_FLOOR_PX**2 + _ROUGHNESS**2 * relief2).astype(np.float32)
    local = _pool_spread(scatter, fused.views, guess)
    single = (_LOCAL_FREEDOM * local**2 + scatter) / (_LOCAL_FREEDOM + freedom)
    beyond = np.maximum(single - _FLOOR_PX**2, 0.0)
    shared = np.minimum(_SHARED * beyond, _SHARED_RELIEF * relief2)
    mean = single * (1.0 + _CORRELATION * freedom) / (1.0 + freedom)
    variance = mean + shared
    return np.where(measured, np.sqrt(variance) * mm_per_px, np.nan).astype(np.float32)


def _pool_spread(
    scatter: NDArray[np.float32], views: NDArray[np.uint8], guess: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the (H, W) standard deviation of one pair, px: the window's mean, or the guess where little is compared.

    Deviations are averaged instead of their squares, so that a few gross ones do not dominate the window.
    """
    root_mean = np.array((1.0, 1.0, *_MEAN_OF_ROOT), np.float32)[np.minimum(views, len(_MEAN_OF_ROOT) + 1)]
    compared = views > 1
    freedom = np.maximum(views.astype(np.float32) - 1.0, 1.0)
    spread = np.where(compared, np.sqrt(scatter / freedom) / root_mean, 0).astype(np.float32)
    total = _sum_windows(spread) + _PRIOR_PIXELS * guess
    return (total / (_sum_windows(compared.astype(np.float32)) + _PRIOR_PIXELS)).astype(np.float32)


def _measure_relief(depth_mm: NDArray[np.float32], mm_per_px: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the (H, W) mean height above the smoothed surroundings, px of disparity."""
    measured = np.isfinite(depth_mm)
    weight = np.maximum(_blur(measured.astype(np.float32)), 1e-3)
    smooth = _blur(np.where(measured, depth_mm, 0)) / weight
    height = np.where(measured, np.minimum(np.abs(depth_mm - smooth) / mm_per_px, 1.0), 0)
    return (_blur(height.astype(np.float32)) / weight).astype(np.float32)


def _blur(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), _RELIEF_RADIUS_PX), np.float32)


def _sum_windows(values: NDArray[np.float32]) -> NDArray[np.float32]:
    total = cv2.boxFilter(values, -1, (_WINDOW_PX, _WINDOW_PX), normalize=False)
    return np.maximum(np.asarray(total, np.float32), 0)  # running sums may be negative by a rounding error
