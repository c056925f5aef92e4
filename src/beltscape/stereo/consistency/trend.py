"""The systematic part of residuals over an image: medians of blocks, which neither noise nor false matches make."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.stereo.consistency.tie_points import Array

LEAST_POINTS = 12
"""Fewer residuals have no trend that is worth a word."""
OF_SCATTER = 0.5
"""A trend smaller than this share of the scatter within blocks may come from the matches: from patches of natural
texture whose depth is wrong."""
_MATCHING_PX = 0.05
"""Trends up to this come from matching: rendered captures under their true rigs have up to 0.03."""
_SIGMAS = 4.0
"""A trend is significant from so many of its standard deviations on."""
_BLOCKS = (4, 3)
"""Columns and rows of blocks over the image."""
_OF_BLOCK = 5
"""Fewer residuals in a block have no median."""
_MEDIAN = 1.2533
"""σ of a median over σ of a mean of normal errors."""
_MAD = 1.4826
"""σ over the median absolute deviation of normal errors."""


@dataclass(frozen=True, slots=True)
class Trend:
    """How far residuals are off zero together."""

    rms_px: float
    """RMS of the block medians, the share that noise has in it taken off; NaN: too few points."""
    sigma_px: float
    """One standard deviation of it."""
    median_px: float
    """Signed median of all."""
    points: int
    concentration: float
    """Share of the residuals near their block's median; false matches scatter."""
    scatter_px: float
    """Typical scatter of a residual within its block, one standard deviation."""

    @property
    def excess_px(self) -> float:
        """What of the trend neither its noise nor the matching explains, px; 0 where it was not measured."""
        least = np.hypot(_MATCHING_PX, OF_SCATTER * self.scatter_px)
        if not self.rms_px - _SIGMAS * self.sigma_px > least:
            return 0.0
        return float(np.sqrt(self.rms_px**2 - least**2))


_NEAR_PX = 3.0
"""Residuals nearer to their block's median than this count as concentrated; false matches scatter over the search."""


def trend_of(residual_px: Array, place_px: Array, size_px: tuple[int, int], scale: float = 1.0) -> Trend:
    """Return the trend of residuals (N,), NaN where there is none, at places (N, 2) of an image.

    ``scale`` is the pixel of the images in which the points were found, in px of the rig.
    """
    good = np.isfinite(residual_px)
    count = int(good.sum())
    if count < LEAST_POINTS:
        return Trend(np.nan, np.nan, np.nan, count, np.nan, np.nan)
    values = residual_px[good]
    column, row = (np.clip((place_px[good] / size_px * _BLOCKS).astype(int), 0, np.array(_BLOCKS) - 1)).T
    medians, variances, weights, scatters, near = [], [], [], [], 0
    for block in np.unique(column + _BLOCKS[0] * row):
        own = values[column + _BLOCKS[0] * row == block]
        if len(own) >= _OF_BLOCK:
            middle = float(np.median(own))
            scatter = _MAD * float(np.median(np.abs(own - middle)))
            medians.append(middle)
            variances.append(_MEDIAN**2 * scatter**2 / len(own))
            weights.append(len(own))
            scatters.append(scatter)
            near += int((np.abs(own - middle) < _NEAR_PX * scale).sum())
    if not medians:
        return Trend(np.nan, np.nan, float(np.median(values)), count, np.nan, np.nan)
    share = np.array(weights) / np.sum(weights)
    noise = float(share @ np.array(variances))
    square = float(share @ np.square(medians))
    rms = float(np.sqrt(max(square - noise, 0.0)))
    sigma = np.sqrt(float(np.square(share) @ np.array(variances)))
    return Trend(
        rms, float(sigma), float(np.median(values)), count, near / sum(weights), float(np.median(scatters))
    )
