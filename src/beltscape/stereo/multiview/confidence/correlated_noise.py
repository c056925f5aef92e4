"""Sigma of a surface where errors of the images are correlated between neighbouring pixels."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.confidence.sigma_inflation import (
    Inflation,
    compute_tile_side,
    estimate_inflation,
)
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.state import MatcherState

Array = NDArray[np.floating]


class _Regime(NamedTuple):
    """Parameters of the excess variance for one kind of noise; chosen on simulated captures with truth."""

    accounted: float
    """Inflation that sigma already accounts for."""
    gain: float
    """Excess of sigma's variance per excess of the inflation."""


_SMOOTHED = _Regime(1.8, 0.8)
"""White noise makes an inflation of 0.5 to 1.7: the core's noise is common to all views. Where neighbours share
noise after resampling, denoising or JPEG, the windows of the fit disagree as well, so sigma contains part of it."""
_DEMOSAICED = _Regime(1.0, 1.2)
"""Interpolation errors of demosaicing follow the texture, not the noise; gains from 0.7 to 2 were tried."""
_ALONE = 2.2
"""Inflation of demosaiced images with a single auxiliary: the median of frames with four."""


def inflate_sigma(sigma: Array, state: MatcherState) -> Array:
    """Return sigma (H, W), px, with the excess variance of correlated noise added to it.

    The excess is a multiple of the least squares' variance, or of sigma's square where that is less: the part of
    sigma that is not noise, at edges and on rough material, is not inflated. Without an excess sigma is unchanged.
    """
    prepared, solution = state.prepared, state.solution
    inflation = estimate_inflation(solution.surface, prepared)
    excess, log_information = _compute_excess(inflation, demosaiced=prepared.noise.demosaiced)
    if not excess.any():
        return sigma
    side = compute_tile_side(prepared.context.scale)
    pixel_excess = _interpolate_by_information(excess, log_information, solution.information, side)
    share = np.minimum(fill_nan(solution.variance) / np.square(sigma), 1)
    return np.asarray(sigma * np.sqrt(1 + pixel_excess * share), np.float32)


def _compute_excess(inflation: Inflation, *, demosaiced: bool) -> tuple[Array, Array]:
    """Return the excess (n,) of sigma's variance over that of least squares, and the log information (n,) it is for.

    Resampling and denoising correlate the noise of a whole image; no part of it has more excess than the whole.
    """
    ratio, log_information = inflation.ratio, inflation.log_information
    if not demosaiced:
        common = np.minimum(ratio, inflation.overall)
        return _SMOOTHED.gain * np.maximum(common - _SMOOTHED.accounted, 0), log_information
    if not len(ratio):
        ratio, log_information = np.full(1, _ALONE), np.zeros(1)
    return _DEMOSAICED.gain * np.maximum(ratio - _DEMOSAICED.accounted, 0), log_information


def _interpolate_by_information(
    values: Array, log_information: Array, information: Array, side: int
) -> NDArray[np.float32]:
    """Return (H, W) values that depend on the information (H, W) around a pixel, interpolated between tiles."""
    height, width = information.shape
    tiles = max(1, width // side), max(1, height // side)
    around = cv2.resize(fill_nan(information), tiles, interpolation=cv2.INTER_AREA)
    tile_values = np.interp(np.log(np.maximum(around, 1e-9)), log_information, values).astype(np.float32)
    return np.asarray(cv2.resize(tile_values, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
