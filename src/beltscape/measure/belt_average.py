"""Several depth maps of one surface that stands still → one with less noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap

_BAND = 64
"""Rows at a time: any number of frames fits into memory."""
_LEAST_SHARE = 0.3
"""A pixel measured in fewer of the frames stays unmeasured."""


def average(frames: Sequence[DepthMap]) -> DepthMap:
    """Mean over frames of one size, robust pixel by pixel.

    Values further from their pixel's median than four robust standard deviations do not count. σ becomes the
    root mean square σ over the root of the number of values: of errors that differ from frame to frame.
    """
    if len(frames) == 1:
        return frames[0]
    shape = frames[0].depth_mm.shape
    depth, sigma = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    views, confidence = np.zeros(shape, np.uint8), np.zeros(shape, np.float32)
    for top in range(0, shape[0], _BAND):
        rows = slice(top, top + _BAND)
        z = np.stack([frame.depth_mm[rows] for frame in frames]).astype(np.float64)
        use = _agreeing(z)
        number = use.sum(axis=0)
        enough = number >= max(1.0, _LEAST_SHARE * len(frames))
        count = np.maximum(number, 1)

        def mean(values: NDArray[np.float64], use: NDArray[np.bool_] = use) -> NDArray[np.float64]:
            return np.where(use, values, 0.0).sum(axis=0) / np.maximum(use.sum(axis=0), 1)

        square = mean(np.stack([frame.sigma_mm[rows] for frame in frames]).astype(np.float64) ** 2)
        depth[rows] = np.where(enough, mean(z), np.nan)
        sigma[rows] = np.where(enough, np.sqrt(square / count), np.nan)
        confidence[rows] = enough * mean(np.stack([f.confidence[rows] for f in frames]).astype(np.float64))
        views[rows] = np.where(enough, np.max(np.where(use, [f.views[rows] for f in frames], 0), axis=0), 0)
    return DepthMap(depth, sigma, views, confidence)


def _agreeing(z: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N, H, W) values that lie near their pixel's median."""
    measured = np.isfinite(z)
    ranked = np.sort(np.where(measured, z, np.inf), axis=0)
    median = _middle(ranked, measured.sum(axis=0))
    off = np.abs(np.where(measured, z, np.inf) - np.where(np.isfinite(median), median, 0.0))
    spread = 1.4826 * _middle(np.sort(off, axis=0), measured.sum(axis=0))
    # of few values the scatter is little known: the whole band's says what is usual
    usual = float(np.median(spread[np.isfinite(spread)])) if np.isfinite(spread).any() else 0.0
    return measured & (off <= 4 * np.maximum(np.where(np.isfinite(spread), spread, 0.0), usual) + 1e-9)


def _middle(ranked: NDArray[np.float64], count: NDArray[np.intp]) -> NDArray[np.float64]:
    """(H, W) median of the first ``count`` of the ranked values (N, H, W); inf where there is none."""
    last = len(ranked) - 1
    low = np.clip((count - 1) // 2, 0, last)[None]
    high = np.clip(count // 2, 0, last)[None]
    both = np.take_along_axis(ranked, low, 0)[0] + np.take_along_axis(ranked, high, 0)[0]
    return np.where(count > 0, 0.5 * both, np.inf)
