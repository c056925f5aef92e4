"""What a depth map pretends: depth where nothing was seen, too small a sigma, errors that follow the pixel grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.evaluate.scores.depth import robust_sigma

SIGMA_BINS = 5
LOCKING_BINS = 10
_MATCHED_PX = 0.5
"""A larger error is not one of interpolation."""


def false_fill(depth: DepthMap, never_seen: NDArray[np.bool_]) -> float:
    """Share of the pixels (H, W) that no auxiliary sees which carry a depth; NaN where every one is seen."""
    filled = np.isfinite(depth.depth_mm[never_seen])
    return float(filled.mean()) if filled.size else np.nan


def sigma_ratios(
    error_mm: NDArray[np.floating], sigma_mm: NDArray[np.floating], bins: int = SIGMA_BINS
) -> NDArray[np.float64]:
    """(bins,) actual over predicted sigma of equally large groups of ascending predicted sigma.

    ``error_mm`` and ``sigma_mm`` are (N,), finite. NaN where a group has no member.
    """
    groups = np.array_split(np.argsort(sigma_mm, kind="stable"), bins)
    return np.array([robust_sigma(error_mm[group] / sigma_mm[group]) for group in groups])


def pixel_locking(
    measured_px: NDArray[np.floating], true_px: NDArray[np.floating], bins: int = LOCKING_BINS
) -> float:
    """Peak to peak, px, of the mean error over the fraction of the true disparity; NaN where a bin is empty.

    ``measured_px`` and ``true_px`` are (N,) disparities in px of the images that were matched. Errors above half
    a px are left out. Independent noise alone gives some 3 standard errors of a bin's mean.
    """
    error = measured_px - true_px
    good = np.abs(error) < _MATCHED_PX
    place = ((true_px[good] % 1.0) * bins).astype(np.intp) % bins
    count = np.bincount(place, minlength=bins)
    if not count.all():
        return np.nan
    return float(np.ptp(np.bincount(place, error[good], minlength=bins) / count))
