"""Do the views agree as well as their noise says? The rig without each frame in turn tells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from beltscape.calibrate.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibrate.solver.bundle import Bundle
from beltscape.calibrate.solver.deterministic import single_thread

Array = NDArray[np.float64]

CONFIDENCE = 0.99
"""Views disagree when their scatter would be less with this probability were the noise all."""


def estimate_inflation(adjustment: BundleAdjustmentResult, covariance: Array, jacobian: Array) -> float:
    """By how much the scatter between frames exceeds the formal standard deviations; 1 where it does not clearly.

    A corner's noise is taken for independent. A board that bends between views, a lens that the model does not
    follow, cameras not quite synchronous make errors that all corners of a frame share; then the formal
    covariance is too small. Leaving out one frame after the other needs no such model (Efron & Stein 1981,
    doi:10.1214/aos/1176345462): the variance is (F − 1)/F·Σ(d_f − d̄)².

    Parameters
    ----------
    covariance
        (R, R) formal covariance of the free parameters of the cameras.
    moves
        (N, R) what is asked about: how N quantities move with these parameters.
    """
    without = _leave_out_frames(adjustment, len(covariance)) @ jacobian.T
    frames = len(without)
    if frames < 3:
        return 1.0
    scatter = (frames - 1) / frames * ((without - without.mean(axis=0)) ** 2).sum()
    ratio = scatter / np.einsum("ni,ij,nj->", jacobian, covariance, jacobian)
    return float(np.sqrt(ratio)) if ratio > chi2.ppf(CONFIDENCE, frames - 1) / (frames - 1) else 1.0


def _leave_out_frames(adjustment: BundleAdjustmentResult, count: int) -> Array:
    """(F, R) how the cameras' free parameters move when a frame is left out, to first order."""
    bundle = adjustment.bundle
    observed = bundle.observations.frame
    moved = []
    with single_thread():
        for frame in np.unique(observed[adjustment.kept]):
            weights = (adjustment.kept & (observed != frame)).astype(np.float64)
            rest = Bundle(bundle.observations, bundle.prior, weights)
            moved.append(rest.linearise(adjustment.geometry).solve_step(0.0)[:count])
    return np.array(moved)
