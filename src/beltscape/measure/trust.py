"""Which pixels of a depth map to believe."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap

_TELLING = 0.999
"""A depth map that trusts every pixel wholly tells nothing of them."""


def trusted(depth: DepthMap, pixel_mm: float, step_mm: float, window_px: float) -> NDArray[np.bool_]:
    """(H, W) pixels to measure by.

    A pixel is left out

    - whose σ exceeds both four typical σ and a pixel's own size on the surface (``pixel_mm``);
    - that only one auxiliary measured, where three or more are usual: nothing confirms it;
    - that steps by more than ``step_mm`` from most of its neighbours in the image: it flies between two surfaces;
    - most of whose neighbours, within the matcher's reach ``window_px``, were left out for these reasons or are
      not measured: what a matcher invents in shadows and beside steps hangs together in such tatters.

    Where the depth map tells of each pixel how far it is to be trusted, that is believed instead: there what is less
    likely true than false is left out, and what flies. Leaving out more makes holes wider, and a wide hole
    beside a step is worse known than a doubtful pixel.
    """
    measured = depth.measured
    if not measured.any():
        return measured
    if depth.confidence[measured].min() < _TELLING:
        return measured & (depth.confidence >= 0.5) & _joined(depth.depth_mm, step_mm)
    typical = float(np.median(depth.sigma_mm[measured]))
    believed = measured & (depth.sigma_mm <= max(pixel_mm, 4 * typical))
    believed &= _joined(depth.depth_mm, step_mm)
    if np.median(depth.views[measured]) >= 3:
        believed &= depth.views >= 2
    if not believed.any():
        return believed
    side = 2 * round(window_px / 2) + 1
    around = ndimage.uniform_filter(believed.astype(np.float32), side, mode="nearest")
    return believed & (around >= 0.5 * np.median(around[believed]))


def _joined(depth_mm: NDArray[np.float32], step_mm: float) -> NDArray[np.bool_]:
    """(H, W) pixels that go on without a step into two of four neighbours, or into all where fewer are measured."""
    padded = np.pad(depth_mm, 1, constant_values=np.nan)
    near, there = np.zeros(depth_mm.shape, np.int8), np.zeros(depth_mm.shape, np.int8)
    for neighbour in (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]):
        step = np.abs(neighbour - depth_mm)
        near += step <= step_mm
        there += np.isfinite(neighbour)
    return near >= np.minimum(there, 2)
