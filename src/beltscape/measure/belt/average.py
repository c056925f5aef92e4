"""The robust mean of several depth maps of one static surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.statistics import MAD_TO_SIGMA

_BAND_ROWS = 64
"""Rows processed at a time, so that any number of frames fits into memory."""
_MIN_SHARE = 0.3
"""A pixel measured in fewer of the frames stays unmeasured."""


def average_depth_maps(frames: Sequence[DepthMap]) -> DepthMap:
    """Return the robust mean of depth maps of one size, pixel by pixel.

    Values further from their pixel's median than four robust standard deviations are rejected. σ becomes the
    root mean square σ over the root of the number of values: the errors count as independent between frames.
    """
    if len(frames) == 1:
        return frames[0]
    shape = frames[0].depth_mm.shape
    depth, sigma = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    views, confidence = np.zeros(shape, np.uint8), np.zeros(shape, np.float32)
    for top in range(0, shape[0], _BAND_ROWS):
        rows = slice(top, top + _BAND_ROWS)
        z = np.stack([frame.depth_mm[rows] for frame in frames]).astype(np.float64)
        use = _inlier_mask(z)
        number = use.sum(axis=0)
        enough = number >= max(1.0, _MIN_SHARE * len(frames))
        count = np.maximum(number, 1)

        def mean(values: NDArray[np.float64], use: NDArray[np.bool_] = use) -> NDArray[np.float64]:
            return np.where(use, values, 0.0).sum(axis=0) / np.maximum(use.sum(axis=0), 1)

        square = mean(np.stack([frame.sigma_mm[rows] for frame in frames]).astype(np.float64) ** 2)
        depth[rows] = np.where(enough, mean(z), np.nan)
        sigma[rows] = np.where(enough, np.sqrt(square / count), np.nan)
        confidence[rows] = enough * mean(np.stack([f.confidence[rows] for f in frames]).astype(np.float64))
        views[rows] = np.where(enough, np.max(np.where(use, [f.views[rows] for f in frames], 0), axis=0), 0)
    return DepthMap(depth, sigma, views, confidence)


def _inlier_mask(z: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which values (N, H, W) lie near their pixel's median."""
    measured = np.isfinite(z)
    ranked = np.sort(np.where(measured, z, np.inf), axis=0)
    median = _median_of_ranked(ranked, measured.sum(axis=0))
    off = np.abs(np.where(measured, z, np.inf) - np.where(np.isfinite(median), median, 0.0))
    spread = MAD_TO_SIGMA * _median_of_ranked(np.sort(off, axis=0), measured.sum(axis=0))
    # the scatter of few values is uncertain: it counts as at least the band's typical scatter
    usual = float(np.median(spread[np.isfinite(spread)])) if np.isfinite(spread).any() else 0.0
    return measured & (off <= 4 * np.maximum(np.where(np.isfinite(spread), spread, 0.0), usual) + 1e-9)


def _median_of_ranked(ranked: NDArray[np.float64], count: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the median (H, W) of the first ``count`` of the ranked values (N, H, W); inf where there is none."""
    last = len(ranked) - 1
    low = np.clip((count - 1) // 2, 0, last)[None]
    high = np.clip(count // 2, 0, last)[None]
    both = np.take_along_axis(ranked, low, 0)[0] + np.take_along_axis(ranked, high, 0)[0]
    return np.where(count > 0, 0.5 * both, np.inf)
