"""Photo-consistency of surfaces: differences between the core's levels and the auxiliaries', after the gain.

The gain of each auxiliary relative to the core is estimated pixel by pixel, with the variance of level differences.
At a depth step no window lies on one surface, so levels cannot be normalised within one. The ratio of the core's
level to an auxiliary's changes slowly (gain, vignetting, angle of the light) and is estimated from the surface
around.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Floats
from beltscape.kernels.planes import FoundPixels, PixelKernels, blur, interpolate_plane, to_single
from beltscape.kernels.selection import PhotoConsistency
from beltscape.kernels.statistics import find_statistics_kernels
from beltscape.stereo.multiview.frame import Noise, PreparedFrame
from beltscape.stereo.multiview.parallel import Pixels, find_pixels, run_pair, run_parallel
from beltscape.stereo.multiview.surface import OCCLUDER_PX, Surface, fill_nan, subsample_projection

_STRIDE = 4
"""Stride of the rows and columns that are evaluated."""
_WINDOW = 9
"""Side of the averaging window in evaluated pixels, at scale 1."""
_COST_SCALE = 0.02
"""Dissimilarity that reduces a pixel's weight to a quarter."""
_PRIOR = 0.01
"""Weight of the whole image's gain in every window."""
_NOISE, _LEVEL, _SLOPE = 3.0, 0.05, 0.15
"""Contributions to the variance: noise of two images and of interpolation (in noise variances), share of the level,
and px by which the sample may be displaced."""
_SOBEL = _SLOPE / 8 * np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]], np.float32)
"""Weights (3, 3) of the difference along a row over `_SLOPE` px: Sobel's, as OpenCV has them."""


@dataclass(frozen=True, slots=True, eq=False)
class PhotometricGain:
    """Gain and variance with which levels of the core and the auxiliaries are compared."""

    gains: list[NDArray[np.float32]]
    """n of (H, W)."""
    variance: NDArray[np.float32]
    """(H, W) levels²."""


def estimate_gain(
    s: Floats, cost: Floats, prepared: PreparedFrame, buffers: Sequence[Floats]
) -> PhotometricGain:
    """Return the auxiliaries' gains and the variance of differences, estimated on the surface s (H, W).

    ``cost`` (H, W) is the dissimilarity of the images on the surface, 0..1; ``buffers`` are the auxiliaries'
    inverse-depth buffers of its occluders.
    """
    gains, variance = run_pair(
        lambda: _estimate_coarse_gains(s, cost, prepared, buffers),
        lambda: compute_difference_variance(prepared.filled_core, prepared.noise),
        prepared.context.threads,
    )
    return PhotometricGain([interpolate_plane(gain, (s.shape[1], s.shape[0])) for gain in gains], variance)


def _estimate_coarse_gains(
    s: Floats, cost: Floats, prepared: PreparedFrame, buffers: Sequence[Floats]
) -> list[NDArray[np.float32]]:
    """Return n planes of every fourth row and column: the factor by which each auxiliary's levels become the core's.

    ``cost`` (H, W) is the dissimilarity of the images on the surface s (H, W), 0..1; ``buffers`` are the auxiliaries'
    inverse-depth buffers of its occluders.
    """
    context, box = prepared.context, prepared.context.windows.boxes[_WINDOW]
    stride = (slice(_STRIDE // 2, None, _STRIDE), slice(_STRIDE // 2, None, _STRIDE))
    coarse_s = s[stride].astype(np.float32, copy=False)
    core, cost, core_with_gaps = (x[stride] for x in (prepared.filled_core, cost, prepared.core))
    similarity = np.square(_COST_SCALE / (_COST_SCALE + cost)) * np.isfinite(core_with_gaps)

    def estimate_one(view: Floats, coefficients: Floats, buffer: Floats) -> NDArray[np.float32]:
        coarse_view = subsample_projection(view, _STRIDE)
        level, _ = context.kernels.warp(coarse_s, coarse_view, coefficients, threads=1)
        visible = context.kernels.visible(coarse_s, coarse_view, buffer, OCCLUDER_PX, threads=1)
        weight = np.where(np.isfinite(level) & (visible > 0), similarity, 0)
        level = fill_nan(level)
        cross, square = ((weight * level * x).astype(np.float32, copy=False) for x in (core, level))
        overall, prior = _find_overall_gain(cross, square)
        gain = (blur(cross, box) + overall * prior) / (blur(square, box) + prior)
        return gain.astype(np.float32, copy=False)

    views = zip(prepared.views, prepared.coefficients, buffers, strict=True)
    return run_parallel([partial(estimate_one, *view) for view in views], context.threads)


def _find_overall_gain(cross: Floats, square: Floats) -> tuple[Any, Any]:
    """Return the gain of the whole image, and the weight that it has in every window; of a GPU's planes on it."""
    kernels = find_statistics_kernels(square)
    if kernels:
        mean, mean_square = kernels.average_plane(cross), kernels.average_plane(square)
        overall = np.where(mean_square > 0, mean / mean_square, np.float32(1))
        return overall, np.maximum(_PRIOR * mean_square, 1e-6)
    total = float(square.sum())
    overall = float(cross.sum()) / total if total > 0 else 1.0
    return overall, np.float32(max(_PRIOR * total / square.size, 1e-6))


def compute_difference_variance(core: Floats, noise: Noise) -> NDArray[np.float32]:
    """Return the (H, W) variance, levels², of the difference between an auxiliary's and the core's level."""
    kernels = find_statistics_kernels(core)
    if kernels:
        slopes = (kernels.filter_plane(core, weights) for weights in (_SOBEL, _SOBEL.T))
        across, down = map(np.square, slopes)
        return across + down + np.square(core * np.float32(_LEVEL)) + _NOISE * to_single(noise.levels)
    across, down = (cv2.Sobel(core, cv2.CV_32F, *d, scale=_SLOPE / 8) for d in ((1, 0), (0, 1)))
    variance = cv2.multiply(across, across)
    variance = cv2.accumulateSquare(down, variance)
    variance = cv2.accumulateSquare(core * np.float32(_LEVEL), variance)
    return np.asarray(cv2.add(variance, _NOISE * noise.levels), np.float32)


PHOTOMETRIC_LIMIT = 3.5
"""Initial confidence (logit) from which on the photo-consistency of a surface is not evaluated."""
_LOG_OFFSET = 0.1
"""Added to differences before the logarithm; smaller differences are equal."""


@dataclass(frozen=True, slots=True, eq=False)
class PhotoConsistencyModel:
    """Images, gain and occluders with which surfaces are compared."""

    prepared: PreparedFrame
    gain: PhotometricGain
    buffers: Sequence[Floats]
    """n of (h, w): inverse-depth buffers of the occluders in each auxiliary."""

    def evaluate(
        self, pixels: Pixels, s: Floats, slopes: tuple[Floats, Floats], threads: int = 1
    ) -> PhotoConsistency:
        """Return the photo-consistency of n surfaces with s and slopes (n, N) at each of N pixels."""
        prepared = self.prepared
        return prepared.context.kernels.photo_consistency(
            pixels[1], pixels[0], s, *slopes, core=prepared.core, variance=self.gain.variance,
            images=prepared.images, views=prepared.views, buffers=self.buffers, gains=self.gain.gains,
            tolerance=OCCLUDER_PX, threads=threads,
        )  # fmt: skip


def compute_photo_consistency_features(
    consistency: PhotoConsistency, auxiliaries: int
) -> Iterator[tuple[str, Floats]]:
    """Yield features by name: logarithms of the differences, and the visible views, also as a share."""
    for name, plane in zip(PhotoConsistency._fields[:-1], consistency[:-1], strict=True):
        offset = plane + np.float32(_LOG_OFFSET)
        yield name.replace("_", " "), np.log(offset, out=offset)
    yield "visible views", np.minimum(consistency.views, 4)
    yield "share of visible views", consistency.views / np.float32(auxiliaries)


def find_doubtful_pixels(initial_confidence: Floats) -> FoundPixels | NDArray[np.bool_]:
    """Return the pixels below `PHOTOMETRIC_LIMIT` of the initial confidence (H, W)."""
    return find_pixels(initial_confidence < PHOTOMETRIC_LIMIT)


def compute_photometric_features(
    surface: Surface,
    initial_confidence: Floats,
    consistency: PhotoConsistencyModel,
    listed: Pixels | None = None,
) -> Iterator[tuple[str, Floats]]:
    """Yield the photo-consistency (H, W) by name, evaluated at the doubtful pixels of `find_doubtful_pixels`.

    They are found anew unless a GPU has listed them. The other pixels count as consistent and visible in no view.
    """
    prepared = consistency.prepared
    auxiliaries = len(prepared.images)
    doubtful = listed or find_doubtful_pixels(initial_confidence)
    if isinstance(doubtful, tuple):
        pixels = doubtful.cut() if isinstance(doubtful, FoundPixels) else doubtful
        given = pixels, surface, initial_confidence, consistency
        yield from prepared.context.kernels.replay(_compute_at, *given).items()
        return
    places = np.flatnonzero(doubtful)
    if not len(places):
        places = np.zeros(1, int)
    planes = surface.s, surface.slope_u, surface.slope_v
    s, slope_u, slope_v = (plane.ravel()[places][None] for plane in planes)
    pixels = np.unravel_index(places, surface.s.shape)
    evaluated = consistency.evaluate(pixels, s, (slope_u, slope_v), prepared.context.threads)
    elsewhere = _list_consistent_values(auxiliaries)
    for name, values in compute_photo_consistency_features(evaluated, auxiliaries):
        plane = np.full(surface.s.shape, elsewhere[name], np.float32)
        plane.ravel()[places] = values[0]
        yield name, plane


def _list_consistent_values(auxiliaries: int) -> dict[str, float]:
    """Return the features by name of pixels that are not evaluated."""
    consistent = PhotoConsistency(*(np.zeros((1, 1), np.float32) for _ in PhotoConsistency._fields))
    features = compute_photo_consistency_features(consistent, auxiliaries)
    return {name: values.item() for name, values in features}


def _compute_at(
    pixels: Pixels, surface: Surface, initial_confidence: Floats, consistency: PhotoConsistencyModel
) -> dict[str, Floats]:
    """Return the photo-consistency (H, W) by name, evaluated at some pixels on a GPU."""
    kernels, auxiliaries = (
        PixelKernels(consistency.prepared.context.kernels.backend),
        len(consistency.prepared.images),
    )
    elsewhere = _list_consistent_values(auxiliaries)
    planes = {name: np.full_like(initial_confidence, value) for name, value in elsewhere.items()}
    if not len(pixels[0]):
        return planes
    s, *slopes = (plane[pixels] for plane in (surface.s, surface.slope_u, surface.slope_v))
    evaluated = consistency.evaluate(pixels, s[None], (slopes[0][None], slopes[1][None]))
    found = dict(compute_photo_consistency_features(evaluated, auxiliaries))
    return {
        name: kernels.put_pixels(plane, pixels, found[name].reshape(-1)) for name, plane in planes.items()
    }
