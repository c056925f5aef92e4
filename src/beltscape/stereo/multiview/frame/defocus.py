"""A core out of focus: its auxiliaries are blurred towards it, for sharp and blurred texture do not match."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.photometry import noise_variance

Level = NDArray[np.float32]

_BLURS_PX = np.arange(1.5, 4.01, 0.25)
"""Less does not harm, and sound rigs and scenes differ by up to one pixel."""
_FINE_PX, _MIDDLE_PX = 1.0, 3.0
"""Sharpness is what texture has finer than the first blur over what it has between the two."""
_SHARE = 0.75
"""Of the blur found: a little sharper than the core, auxiliaries give more than they lose (tried from 0.5 to 1)."""
_ROWS = 160
"""Of the image's middle are looked at."""


def match_defocus(core: str, levels: Mapping[str, Level]) -> dict[str, Level]:
    """Levels (H, W) by camera, the others blurred where ``core`` is out of focus beside them; else as they are."""
    blur_px = _SHARE * estimate_defocus(
        levels[core], [level for name, level in levels.items() if name != core]
    )
    return {name: level if name == core else _blurred(level, blur_px) for name, level in levels.items()}


def estimate_defocus(core: Level, others: list[Level]) -> float:
    """Sigma of the Gaussian that makes the others, by their median, no sharper than the core.

    0 where less than 1.5 px would do, 4 where more is needed.
    """
    own = _sharpness(_middle(core), 0)
    bands = [_middle(other) for other in others]
    for blur_px in _BLURS_PX:
        if np.median([_sharpness(band, blur_px) for band in bands]) <= own:
            return 0.0 if blur_px == _BLURS_PX[0] else float(blur_px)
    return float(_BLURS_PX[-1])


def _sharpness(band: Level, blur_px: float) -> float:
    """Variance of the fine over that of the middle texture after a blur, noise subtracted."""
    fine_px, middle_px = np.hypot(blur_px, _FINE_PX), np.hypot(blur_px, _MIDDLE_PX)
    own, fine, middle = (_blurred(band, sigma) for sigma in (blur_px, fine_px, middle_px))
    high = float(np.var(own - fine)) - noise_variance(band) * _passed(blur_px, fine_px)
    low = float(np.var(fine - middle))
    return max(high, 0.0) / low if low > 0 else 0.0


def _passed(narrow_px: float, wide_px: float) -> float:
    """Share of white noise's variance that a difference of two Gaussians lets through."""
    peak = np.zeros((41, 41), np.float32)
    peak[20, 20] = 1
    return float(np.square(_blurred(peak, narrow_px) - _blurred(peak, wide_px)).sum())


def _middle(level: Level) -> Level:
    start = max(0, (len(level) - _ROWS) // 2)
    return level[start : start + _ROWS]


def _blurred(level: Level, sigma_px: float) -> Level:
    return (
        level if sigma_px == 0 else np.asarray(cv2.GaussianBlur(level, (0, 0), float(sigma_px)), np.float32)
    )
