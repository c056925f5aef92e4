"""The systematic part of residuals over an image: medians of blocks, which neither noise nor false matches affect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.statistics import MAD_TO_SIGMA, MEDIAN_TO_MEAN_SIGMA
from beltscape.stereo.consistency.tie_points.tie_points import Array

LEAST_POINTS = 12
"""Fewer residuals give no usable estimate."""
SCATTER_SHARE = 0.5
"""A systematic residual below this share of the scatter within blocks may come from the matches, such as patches of
natural texture whose depth is wrong."""
SIGNIFICANT_SIGMAS = 4.0
"""A systematic residual is significant from this number of its standard deviations on."""
_MATCHING_PX = 0.05
"""The matching itself causes residuals up to this; rendered captures under their true rigs have up to 0.03."""
BLOCKS = (4, 3)
"""Columns and rows of blocks over the image."""
LEAST_IN_BLOCK = 5
"""A block with fewer residuals is left out."""
_INLIER_PX = 3.0
"""An inlier is nearer than this to its block's median; false matches scatter over the search area."""


@dataclass(frozen=True, slots=True)
class SystematicResidual:
    """Common part of the residuals of an image."""

    rms_px: float
    """RMS of the block medians without the share of the noise; NaN: too few points."""
    sigma_px: float
    """One standard deviation of it."""
    median_px: float
    """Signed median of all residuals."""
    points: int
    inlier_share: float
    """Share of the residuals near their block's median; near that of all where no block has enough."""
    scatter_px: float
    """Median over the blocks of one standard deviation within a block."""

    @property
    def excess_px(self) -> float:
        """The part that neither noise nor matching explains, px; 0 where it was not measured."""
        least = np.hypot(_MATCHING_PX, SCATTER_SHARE * self.scatter_px)
        if not self.rms_px - SIGNIFICANT_SIGMAS * self.sigma_px > least:
            return 0.0
        return float(np.sqrt(self.rms_px**2 - least**2))


def find_blocks(pixels: Array, size_px: tuple[int, int]) -> NDArray[np.int64]:
    """Return (N,) the number of the block in which each pixel (N, 2) of an image lies."""
    column, row = (np.clip((pixels / size_px * BLOCKS).astype(np.int64), 0, np.array(BLOCKS) - 1)).T
    return column + BLOCKS[0] * row


def estimate_systematic_residual(
    residual_px: Array, pixels: Array, size_px: tuple[int, int], pixel_scale: float = 1.0
) -> SystematicResidual:
    """Return the systematic part of residuals (N,), NaN where missing, at pixels (N, 2) of an image.

    ``pixel_scale`` is the pixel of the images in which the points were matched, in px of the rig's images.
    """
    good = np.isfinite(residual_px)
    count = int(good.sum())
    if count < LEAST_POINTS:
        return SystematicResidual(np.nan, np.nan, np.nan, count, np.nan, np.nan)
    values = residual_px[good]
    block_index = find_blocks(pixels[good], size_px)
    medians: list[float] = []
    variances: list[float] = []
    weights: list[int] = []
    scatters: list[float] = []
    inliers = 0
    for block in np.unique(block_index):
        own = values[block_index == block]
        if len(own) >= LEAST_IN_BLOCK:
            median = float(np.median(own))
            scatter = MAD_TO_SIGMA * float(np.median(np.abs(own - median)))
            medians.append(median)
            variances.append(MEDIAN_TO_MEAN_SIGMA**2 * scatter**2 / len(own))
            weights.append(len(own))
            scatters.append(scatter)
            inliers += int((np.abs(own - median) < _INLIER_PX * pixel_scale).sum())
    if not medians:  # too few in every block: inliers are near the median of all
        middle = float(np.median(values))
        near = float((np.abs(values - middle) < _INLIER_PX * pixel_scale).mean())
        return SystematicResidual(np.nan, np.nan, middle, count, near, np.nan)
    share = np.array(weights) / np.sum(weights)
    noise = float(share @ np.array(variances))
    square = float(share @ np.square(medians))
    rms = float(np.sqrt(max(square - noise, 0.0)))
    sigma = np.sqrt(float(np.square(share) @ np.array(variances)))
    return SystematicResidual(
        rms,
        float(sigma),
        float(np.median(values)),
        count,
        inliers / sum(weights),
        float(np.median(scatters)),
    )
