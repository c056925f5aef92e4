"""The selection of a depth map's reliable pixels for measuring."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap

FULL_CONFIDENCE = 0.999
"""A depth map whose confidence is this high everywhere does not rate its pixels."""


def reliable_mask(depth: DepthMap, pixel_mm: float, step_mm: float, window_px: float) -> NDArray[np.bool_]:
    """Return which pixels (H, W) are reliable enough to measure by.

    A pixel is excluded

    - if its σ exceeds both four typical σ and a pixel's size on the surface (``pixel_mm``);
    - if only one auxiliary measured it, where three or more are usual: nothing confirms it;
    - if it differs by more than ``step_mm`` from most of its neighbours: it is a flying pixel between two surfaces;
    - if most of its neighbours, within the matcher's windows ``window_px``, are excluded for these reasons or not
      measured: false matches in shadows and beside steps form such fragments.

    Where the depth map rates its pixels, its confidence is used instead: pixels below one half and flying pixels are
    excluded. Excluding more would make holes wider, and the height in a wide hole beside a step is less certain than
    that of an uncertain pixel.
    """
    measured = depth.measured
    if not measured.any():
        return measured
    if depth.confidence[measured].min() < FULL_CONFIDENCE:
        return measured & (depth.confidence >= 0.5) & _continuous_mask(depth.depth_mm, step_mm)
    typical = float(np.median(depth.sigma_mm[measured]))
    reliable = measured & (depth.sigma_mm <= max(pixel_mm, 4 * typical))
    reliable &= _continuous_mask(depth.depth_mm, step_mm)
    if np.median(depth.views[measured]) >= 3:
        reliable &= depth.views >= 2
    if not reliable.any():
        return reliable
    side = 2 * round(window_px / 2) + 1
    around = ndimage.uniform_filter(reliable.astype(np.float32), side, mode="nearest")
    return reliable & (around >= 0.5 * np.median(around[reliable]))


def _continuous_mask(depth_mm: NDArray[np.float32], step_mm: float) -> NDArray[np.bool_]:
    """Return the pixels (H, W) continuous with two of four neighbours, or with all where fewer are measured."""
    padded = np.pad(depth_mm, 1, constant_values=np.nan)
    near, there = np.zeros(depth_mm.shape, np.int8), np.zeros(depth_mm.shape, np.int8)
    for neighbour in (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]):
        step = np.abs(neighbour - depth_mm)
        near += step <= step_mm
        there += np.isfinite(neighbour)
    return near >= np.minimum(there, 2)
