"""Jackknife over board positions: inflation of the covariance if the views scatter by more than their noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from beltscape.calibration.assessment.uncertainty.board_positions import group_frames
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.solver.bundle import Bundle
from beltscape.calibration.solver.deterministic import single_thread

Array = NDArray[np.float64]

CONFIDENCE = 0.99
"""Probability of a smaller scatter from noise alone above which the views are taken to disagree."""
MIN_POSITIONS = 3
"""Least number of board positions for a scatter."""


def estimate_inflation(adjustment: BundleAdjustmentResult, covariance: Array, jacobian: Array) -> float:
    """Return the ratio of the scatter between frames to the formal standard deviations; 1 if not significant.

    The formal covariance takes the corners' noise as independent. It is too small if all corners of a frame share
    errors: from a board that bends between views, a lens that the model does not describe, cameras that are not quite
    synchronous. Leaving out one position of the board at a time needs no such assumption (Efron & Stein 1981,
    doi:10.1214/aos/1176345462): the variance is (F − 1)/F·Σ(d_f − d̄)².

    Parameters
    ----------
    covariance
        (R, R) formal covariance of the free parameters of the cameras.
    jacobian
        (N, R) derivatives of the N quantities of interest by these parameters.
    """
    without = _leave_out_positions(adjustment, len(covariance)) @ jacobian.T
    frames = len(without)
    if frames < MIN_POSITIONS:
        return 1.0
    scatter = (frames - 1) / frames * ((without - without.mean(axis=0)) ** 2).sum()
    ratio = scatter / np.einsum("ni,ij,nj->", jacobian, covariance, jacobian)
    return float(np.sqrt(ratio)) if ratio > chi2.ppf(CONFIDENCE, frames - 1) / (frames - 1) else 1.0


def _leave_out_positions(adjustment: BundleAdjustmentResult, count: int) -> Array:
    """Return the change (F, R) of the cameras' free parameters without a position of the board, to first order.

    Frames of one position share their errors; they are left out together if there are three positions or more.
    """
    bundle, positions = adjustment.bundle, group_frames(adjustment)
    if len(set(positions.values())) < MIN_POSITIONS:
        positions = {frame: number for number, frame in enumerate(positions)}
    position = np.array([positions.get(int(frame), -1) for frame in bundle.observations.frame])
    changes: list[Array] = []
    with single_thread():
        for each in np.unique(position[adjustment.used]):
            weights = (adjustment.used & (position != each)).astype(np.float64)
            rest = Bundle(bundle.observations, bundle.prior, weights)
            changes.append(rest.linearise(adjustment.geometry).solve_step(0.0)[:count])
    return np.array(changes)
