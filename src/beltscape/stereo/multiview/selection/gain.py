"""How bright the auxiliaries are beside the core, place by place, and by how much their levels may differ.

Next to a step no window lies on one surface, so levels cannot be normalised in one. The core's level over an
auxiliary's changes slowly (gain, vignetting, the light's angle), so it can be told from the surface around.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import Noise, PreparedFrame, subsample_projection
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.parallel import run_parallel
from beltscape.stereo.multiview.frame.visibility import OCCLUDER_PX

Array = NDArray[np.floating]

_EVERY = 4
"""Of so many rows and columns one is looked at, ..."""
_WINDOW = 9
"""... and so many of those by so many are averaged, at scale 1."""
_ALIKE = 0.02
"""A dissimilarity of that halves a pixel's say."""
_PRIOR = 0.01
"""The whole image's share in every place."""
_NOISE, _LEVEL, _SLOPE = 3.0, 0.05, 0.15
"""Variances: noise of two images and of sampling between pixels, share of the level, px the sample may be off."""


@dataclass(frozen=True, slots=True, eq=False)
class PhotometricGain:
    """What levels are compared by."""

    gains: list[NDArray[np.float32]]
    """n of (H, W)."""
    variance: NDArray[np.float32]
    """(H, W) levels²."""


def estimate_gain(
    s: Array,
    cost: Array,
    prepared: PreparedFrame,
    buffers: Sequence[Array],
    scale: float,
    kernels: Kernels,
    threads: int,
) -> PhotometricGain:
    """The auxiliaries' gains and the variance of differences, told by a surface s (H, W) and what fits it."""
    return PhotometricGain(
        estimate_gain_maps(s, cost, prepared, buffers, scale, kernels, threads),
        difference_variance(prepared.core, prepared.noise),
    )


def estimate_gain_maps(
    s: Array,
    cost: Array,
    prepared: PreparedFrame,
    buffers: Sequence[Array],
    scale: float,
    kernels: Kernels,
    threads: int,
) -> list[NDArray[np.float32]]:
    """N of (H, W): what each auxiliary's levels are to be multiplied by to be the core's.

    ``cost`` (H, W) is how unlike the images are on the surface s (H, W), 0..1; ``buffers`` are of what
    hides it.
    """
    inside = (slice(_EVERY // 2, None, _EVERY), slice(_EVERY // 2, None, _EVERY))
    thin, core = np.ascontiguousarray(s[inside], np.float32), prepared.core[inside]
    alike = (_ALIKE / (_ALIKE + fill_nan(cost[inside], 1.0))) ** 2 * np.isfinite(core)
    side = 2 * int(_WINDOW * scale / 2) + 1

    def one(view: Array, coefficients: Array, buffer: Array) -> NDArray[np.float32]:
        row = subsample_projection(view, _EVERY)
        level, _ = kernels.warp(thin, row, coefficients, threads=1)
        seen = kernels.visible(thin, row, buffer, OCCLUDER_PX, threads=1)
        weight = np.where(np.isfinite(level) & (seen > 0), alike, 0)
        level, own = fill_nan(level), fill_nan(core)
        cross, square = (np.asarray(weight * level * x, np.float32) for x in (own, level))
        total = float(square.sum())
        whole = float(cross.sum()) / total if total > 0 else 1.0
        prior = np.float32(max(_PRIOR * total / square.size, 1e-6))
        gain = (cv2.blur(cross, (side, side)) + whole * prior) / (cv2.blur(square, (side, side)) + prior)
        size = s.shape[1], s.shape[0]
        return np.asarray(cv2.resize(gain, size, interpolation=cv2.INTER_LINEAR), np.float32)

    views = zip(prepared.views, prepared.coefficients, buffers, strict=True)
    return run_parallel([partial(one, *view) for view in views], threads)


def difference_variance(core: Array, noise: Noise) -> NDArray[np.float32]:
    """(H, W) variance, levels², of the difference between the core's levels and an auxiliary's of the same point."""
    level = fill_nan(core)
    across, down = (cv2.Sobel(level, cv2.CV_32F, *d, scale=_SLOPE / 8) for d in ((1, 0), (0, 1)))
    variance = cv2.multiply(across, across)
    variance = cv2.accumulateSquare(down, variance)
    variance = cv2.accumulateSquare(np.multiply(level, np.float32(_LEVEL), out=level), variance)
    return np.asarray(cv2.add(variance, _NOISE * noise.levels), np.float32)
