"""Reliability of a depth map: depth at occluded pixels, calibration of σ, and pixel locking."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.evaluate.scores.depth import compute_robust_sigma

SIGMA_BINS = 5
"""Number of groups of equal size by predicted σ."""
LOCKING_BINS = 10
"""Number of bins of the disparity's fraction, a tenth of a pixel each."""
_MATCHED_PX = 0.5
"""A larger error is a false match, not an interpolation error."""


def compute_false_fill(depth: DepthMap, occluded: NDArray[np.bool_]) -> float:
    """Return the share of the pixels (H, W) occluded in all auxiliaries that have a depth; NaN without any."""
    filled = np.isfinite(depth.depth_mm[occluded])
    return float(filled.mean()) if filled.size else np.nan


def compute_sigma_ratios(
    error_mm: NDArray[np.floating], sigma_mm: NDArray[np.floating], bins: int = SIGMA_BINS
) -> NDArray[np.float64]:
    """Return actual over predicted σ, (bins,), of equally large groups of ascending predicted σ.

    ``error_mm`` and ``sigma_mm`` are (N,); pixels without a finite σ are left out. NaN for an empty group.
    """
    known = np.isfinite(sigma_mm)
    error_mm, sigma_mm = error_mm[known], sigma_mm[known]
    groups = np.array_split(np.argsort(sigma_mm, kind="stable"), bins)
    return np.array([compute_robust_sigma(error_mm[group] / sigma_mm[group]) for group in groups])


def compute_pixel_locking(
    measured_px: NDArray[np.floating], true_px: NDArray[np.floating], bins: int = LOCKING_BINS
) -> float:
    """Return the peak-to-peak mean error, px, over the fraction of the true disparity; NaN for an empty bin.

    ``measured_px`` and ``true_px`` are (N,) disparities in px of the matched images. Errors above half a px are left
    out. Independent noise alone gives about 3 standard errors of a bin's mean.
    """
    error = measured_px - true_px
    good = np.abs(error) < _MATCHED_PX
    index = ((true_px[good] % 1.0) * bins).astype(np.intp) % bins
    count = np.bincount(index, minlength=bins)
    if not count.all():
        return np.nan
    return float(np.ptp(np.bincount(index, error[good], minlength=bins) / count))
