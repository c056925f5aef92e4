"""How noisy a frame is, told by its own residuals.

Normalised in a window, the levels of core and auxiliary differ with the variance

    levels (1 / variance_I + 1 / variance_J) + model,

the first part from the sensors, the second from sampling, gloss and what the model leaves out. The residuals of a
roughly right surface, where there is texture, tell by how much both are to be raised or lowered.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import Noise, PreparedFrame, crop_projection
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.photometry import local_moments
from beltscape.stereo.multiview.frame.surface import Surface

Array = NDArray[np.floating]

_BANDS, _ROWS = 4, 64
"""So many bands of rows are looked at."""
_MEDIAN = 0.4549
"""Of χ² with one degree of freedom: outliers do not move it."""
_SCALE = (1 / 16, 64.0)
"""The residuals do not change the guess by more: the surface may be wrong."""


def estimate_noise(surface: Surface, prepared: PreparedFrame, kernels: Kernels, threads: int) -> Noise:
    """The prepared frame's noise, scaled to the residuals of all views on a few bands of rows."""
    guess = prepared.noise
    misfits = []
    for first in np.linspace(0, max(0, len(surface.s) - _ROWS), _BANDS).astype(int):
        misfits += _misfits(surface.s, prepared, int(first), kernels, threads)
    every = np.concatenate(misfits)
    if not every.size:
        return guess
    scale = float(np.clip(np.median(every) / _MEDIAN, *_SCALE))
    return replace(guess, levels=guess.levels * scale, model=guess.model * scale)


def _misfits(s: Array, prepared: PreparedFrame, first: int, kernels: Kernels, threads: int) -> list[Array]:
    """Per view, squared residual over its expected variance where the texture of a band is above its median."""
    rows = slice(first, first + _ROWS)
    noise = prepared.noise
    core = fill_nan(prepared.core[rows])
    own, own_variance = _normalised(core, noise.floor)
    textured = np.isfinite(prepared.core[rows]) & (own_variance >= np.median(own_variance))
    band = np.ascontiguousarray(s[rows])
    misfits = []
    for view, coefficients in zip(prepared.views, prepared.coefficients, strict=True):
        value, _ = kernels.warp(band, crop_projection(view, 0, first), coefficients, threads=threads)
        seen = np.isfinite(value)
        other, variance = _normalised(np.where(seen, value, core).astype(np.float32), noise.floor)
        expected = np.float32(noise.levels) * (1 / own_variance + 1 / variance) + np.float32(noise.model)
        misfits.append(((own - other) ** 2 / expected)[seen & textured])
    return misfits


def _normalised(level: Array, floor: float) -> tuple[Array, Array]:
    mean, variance = local_moments(level)
    variance = variance + np.float32(floor)
    return (level - mean) / np.sqrt(variance), variance
