"""Robust statistics of a bundle adjustment: Student weights, each camera's noise, and outlier rejection."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.solver.bundle import Bundle
from beltscape.calibration.solver.bundle_data import Geometry, Observations
from beltscape.core.statistics import MAD_TO_SIGMA

Array = NDArray[np.float64]

STUDENT_DOF = 5.0
"""Degrees of freedom of Student's t, which weights corners while the board's shape is estimated."""
MAX_DEVIATION = 4.5
"""Corners with larger errors, in standard deviations, are left out of the final adjustment."""
MIN_SHARE = 0.5
"""A view with a smaller share of accepted corners is left out as a whole."""


def estimate_robust_sigma(values: Array) -> float:
    """Return the standard deviation of values about zero from their median absolute value; NaN without any."""
    return float(MAD_TO_SIGMA * np.median(np.abs(values))) if values.size else float("nan")


def compute_student_weights(squared: Array) -> Array:
    """Return Student weights (N,) of corners with squared standardised errors (N,)."""
    return (STUDENT_DOF + 2) / (STUDENT_DOF + squared)


def estimate_student_sigma(bundle: Bundle, geometry: Geometry, sigma: Array, spread: float) -> Array:
    """Return the scale (C,) of Student's t for each camera's errors, by one step of expectation-maximisation."""
    camera = bundle.observations.camera
    squared = (bundle.compute_errors_px(geometry) ** 2).sum(axis=1)
    weights = compute_student_weights(squared / sigma[camera] ** 2)
    total = np.bincount(camera, weights * squared, minlength=len(sigma))
    count = 2 * np.bincount(camera, minlength=len(sigma)).clip(1)
    return _limit_spread(np.sqrt(total / count), count, spread)


def select_corners(bundle: Bundle, geometry: Geometry, spread: float) -> tuple[NDArray[np.bool_], Array]:
    """Return the accepted corners and each camera's noise from them, corrected for the degrees of freedom."""
    errors, camera = bundle.compute_errors_px(geometry), bundle.observations.camera
    cameras = len(geometry.intrinsics)
    robust = np.array([estimate_robust_sigma(errors[camera == c]) for c in range(cameras)])
    robust = _limit_spread(robust, np.bincount(camera, minlength=cameras), spread)
    kept = _mask_whole_views(
        np.linalg.norm(errors, axis=1) < MAX_DEVIATION * robust[camera], bundle.observations
    )
    fitted = len(bundle.free) + 6 * len(geometry.board_rotation)
    share = 1 - fitted / max(2 * int(kept.sum()), fitted + 1)
    sigma = np.array([np.sqrt((errors[kept & (camera == c)] ** 2).mean() / share) for c in range(cameras)])
    return kept, _limit_spread(sigma, np.bincount(camera[kept], minlength=cameras), spread)


def _limit_spread(sigma: Array, count: NDArray[np.intp], spread: float) -> Array:
    """Return each camera's noise, limited to within a factor ``spread`` of the rig's.

    Without the limit one camera's noise shrinks to 0: the larger its weight, the better boards and shape fit it.
    """
    pooled = float(np.sqrt((count * sigma**2).sum() / count.sum()))
    return np.clip(sigma, pooled / spread, pooled * spread)


def _mask_whole_views(kept: NDArray[np.bool_], observations: Observations) -> NDArray[np.bool_]:
    """Remove the remaining corners of views that lost most of theirs: the board moved, the rest agree by chance."""
    view = observations.frame * (observations.camera.max() + 1) + observations.camera
    share = np.bincount(view, kept) / np.bincount(view).clip(1)
    return kept & (share[view] >= MIN_SHARE)
