"""Defocus of the core: the auxiliaries are blurred to match, since sharp and blurred texture do not correlate."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.parallel import run_parallel
from beltscape.stereo.multiview.frame.photometry import estimate_noise_variance

Level = NDArray[np.float32]

_BLURS_PX = np.arange(1.5, 4.01, 0.25)
"""Blurs that are tried. A smaller difference does no harm; sound rigs and scenes differ by up to one pixel."""
_FINE_PX, _MIDDLE_PX = 1.0, 3.0
"""Sharpness is the variance of texture finer than the first blur over that between the two blurs."""
_SHARE = 0.75
"""Share of the estimated blur that is applied: slightly sharper auxiliaries match better (0.5 to 1 were tried)."""
_ROWS = 160
"""Number of rows in the middle of the image that are examined."""


def match_defocus(core: str, levels: Mapping[str, Level], threads: int = 1) -> dict[str, Level]:
    """Return levels (H, W) by camera, the auxiliaries blurred where ``core`` is out of focus compared with them."""
    blur_px = _SHARE * estimate_defocus(
        levels[core], [level for name, level in levels.items() if name != core], threads
    )
    return {name: level if name == core else _blur(level, blur_px) for name, level in levels.items()}


def estimate_defocus(core: Level, others: list[Level], threads: int = 1) -> float:
    """Return the sigma (px) of the Gaussian that makes the median auxiliary no sharper than the core.

    It is 0 where less than 1.5 px suffices, and 4 where more is needed.
    """
    core_sharpness = _measure_sharpness(_select_middle_rows(core), 0)
    bands = [_select_middle_rows(other) for other in others]
    for blur_px in _BLURS_PX:
        jobs = [partial(_measure_sharpness, band, float(blur_px)) for band in bands]
        if np.median(run_parallel(jobs, threads)) <= core_sharpness:
            return 0.0 if blur_px == _BLURS_PX[0] else float(blur_px)
    return float(_BLURS_PX[-1])


def _measure_sharpness(band: Level, blur_px: float) -> float:
    """Return the variance of fine texture over that of medium texture after a blur, with noise subtracted."""
    fine_px, middle_px = np.hypot(blur_px, _FINE_PX), np.hypot(blur_px, _MIDDLE_PX)
    levels, fine, medium = (_blur(band, sigma) for sigma in (blur_px, fine_px, middle_px))
    high = float(np.var(levels - fine)) - estimate_noise_variance(band) * _compute_noise_gain(
        blur_px, fine_px
    )
    low = float(np.var(fine - medium))
    return max(high, 0.0) / low if low > 0 else 0.0


def _compute_noise_gain(narrow_px: float, wide_px: float) -> float:
    """Return the share of white noise's variance that passes a difference of two Gaussians."""
    impulse = np.zeros((41, 41), np.float32)
    impulse[20, 20] = 1
    return float(np.square(_blur(impulse, narrow_px) - _blur(impulse, wide_px)).sum())


def _select_middle_rows(level: Level) -> Level:
    start = max(0, (len(level) - _ROWS) // 2)
    return level[start : start + _ROWS]


def _blur(level: Level, sigma_px: float) -> Level:
    return (
        level if sigma_px == 0 else np.asarray(cv2.GaussianBlur(level, (0, 0), float(sigma_px)), np.float32)
    )
