"""Estimation of a frame's noise from the residuals of a surface.

Levels of the core and an auxiliary, normalised in a window, differ with the variance

    levels (1 / variance_I + 1 / variance_J) + model.

The first part comes from the sensors, the second from sampling, gloss and other model errors. The residuals of an
approximate surface, where there is texture, give a common factor for both.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from beltscape.core.statistics import CHI2_MEDIAN
from beltscape.stereo.multiview.frame.frame import Noise, PreparedFrame
from beltscape.stereo.multiview.frame.inverse_depth import crop_projection
from beltscape.stereo.multiview.frame.parallel import run_parallel
from beltscape.stereo.multiview.frame.photometry import compute_local_moments
from beltscape.stereo.multiview.frame.surface import Surface

Array = NDArray[np.floating]

_BANDS, _ROWS = 4, 64
"""Number of bands that are examined, and of rows in each."""
_SCALE = (1 / 16, 64.0)
"""Range of the factor, since the surface may be wrong."""


def estimate_noise(surface: Surface, prepared: PreparedFrame) -> Noise:
    """Return the prepared frame's noise, scaled to the residuals of all views on a few bands of rows."""
    noise = prepared.noise
    bands = np.linspace(0, max(0, len(surface.s) - _ROWS), _BANDS).astype(int)
    jobs = [partial(_compute_squared_residuals, surface.s, prepared, int(first)) for first in bands]
    ratios = np.concatenate([each for band in run_parallel(jobs, prepared.context.threads) for each in band])
    if not ratios.size:
        return noise
    scale = float(np.clip(np.median(ratios) / CHI2_MEDIAN, *_SCALE))
    return replace(noise, levels=noise.levels * scale, model=noise.model * scale)


def _compute_squared_residuals(s: Array, prepared: PreparedFrame, first: int) -> list[Array]:
    """Return each view's squared residuals over their expected variance, for the more textured half of a band."""
    rows = slice(first, first + _ROWS)
    noise, context = prepared.noise, prepared.context
    core = prepared.filled_core[rows]
    core_level, core_variance = _normalise(core, noise.floor)
    textured = np.isfinite(prepared.core[rows]) & (core_variance >= np.median(core_variance))
    band = np.ascontiguousarray(s[rows])
    residuals: list[Array] = []
    for view, coefficients in zip(prepared.views, prepared.coefficients, strict=True):
        warped, _ = context.kernels.warp(band, crop_projection(view, 0, first), coefficients, threads=1)
        valid = np.isfinite(warped)
        level, variance = _normalise(np.where(valid, warped, core), noise.floor)
        expected = np.float32(noise.levels) * (1 / core_variance + 1 / variance) + np.float32(noise.model)
        residuals.append(((core_level - level) ** 2 / expected)[valid & textured])
    return residuals


def _normalise(level: Array, floor: float) -> tuple[Array, Array]:
    mean, variance = compute_local_moments(level)
    variance = variance + np.float32(floor)
    return (level - mean) / np.sqrt(variance), variance
