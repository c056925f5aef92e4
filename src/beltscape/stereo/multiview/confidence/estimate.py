"""The final estimate of a surface: inverse depth, sigma, confidence and number of views of every pixel."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.confidence.correlated_noise import inflate_sigma
from beltscape.stereo.multiview.confidence.features import (
    compute_agreement_features,
    compute_information_features,
    compute_shape_features,
)
from beltscape.stereo.multiview.confidence.refined_features import (
    compute_initial_confidence_features,
    compute_photometric_features,
    compute_reliability_features,
)
from beltscape.stereo.multiview.confidence.refiner import (
    Prediction,
    RefinementInputs,
    refine_uncertain_pixels,
)
from beltscape.stereo.multiview.confidence.roughness import compute_roughness_features
from beltscape.stereo.multiview.frame.context import MatchContext
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.parallel import run_pair, run_parallel
from beltscape.stereo.multiview.frame.photometry import compute_texture_ratio
from beltscape.stereo.multiview.frame.visibility import compute_visibility
from beltscape.stereo.multiview.frame.windows import scale_window
from beltscape.stereo.multiview.networks import load_network
from beltscape.stereo.multiview.selection.candidates import Selection
from beltscape.stereo.multiview.selection.photoconsistency import PhotoConsistencyModel
from beltscape.stereo.multiview.state import MatcherState

Array = NDArray[np.floating]

REACH_PX = 9
"""Window around texture in which pixels without texture are measured, since the fit's window includes the texture."""
TEXTURE, TEXTURE_PX = 2.0, 9
"""Ratio of the variance to the noise's up to which a window has no texture, and its side in px at scale 1."""
CONTRADICTION = 0.4
"""Mean dissimilarity from which on the surface is rejected where no view agrees."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthEstimate:
    """The estimate per pixel of the matcher's grid."""

    s: Array
    """(H, W) inverse depth, refined at uncertain pixels."""
    sigma: Array
    """(H, W) one standard deviation of s, px."""
    confidence: Array
    """(H, W) probability that the pixel is not a false surface."""
    views: NDArray[np.uint8]
    """(H, W) number of auxiliaries that see the pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class PixelFeatures:
    """Features of a surface's pixels, and their visibility."""

    planes: dict[str, Array]
    """(H, W) by name."""
    visible: NDArray[np.uint8]
    """(H, W) number of auxiliaries that see the surface."""


Features = Callable[[], Iterator[tuple[str, Array]]]


def compute_initial_features(state: MatcherState) -> PixelFeatures:
    """Return the features of a matched surface before candidate selection."""
    visible, _ = compute_visibility(state.solution.surface.s, state.prepared)
    planes = _compute_planes(_list_surface_features(state, visible), state.prepared.context)
    return PixelFeatures(planes | state.image_features, visible)


def add_initial_confidence(features: PixelFeatures, context: MatchContext) -> dict[str, Array]:
    """Return the planes (H, W) by name of initial features, with the initial confidence and its means."""
    network = load_network("initial_confidence")
    (logit,) = network.evaluate(features.planes, context.kernels, context.threads)
    return features.planes | dict(compute_initial_confidence_features(logit, context.scale))


def compute_refined_features(
    state: MatcherState, selection: Selection
) -> tuple[PixelFeatures, RefinementInputs]:
    """Return the features of the surface after candidate selection, and the inputs of the refinement network."""
    surface, confidence = state.solution.surface, selection.initial_confidence
    context = state.prepared.context
    visible, buffers = compute_visibility(surface.s, state.prepared)
    consistency = PhotoConsistencyModel(state.prepared, selection.gain, buffers)
    parts: list[Features] = [
        lambda: compute_photometric_features(surface, confidence, consistency),
        lambda: compute_reliability_features(surface, confidence, context.scale),
        lambda: compute_initial_confidence_features(confidence, context.scale),
    ]
    planes = (
        _compute_planes([*_list_surface_features(state, visible), *parts], context) | state.image_features
    )
    planes |= dict(compute_roughness_features(state.solution, planes["slope deviation"], context.scale))
    return PixelFeatures(planes, visible), RefinementInputs.from_surface(planes, surface, consistency)


def _list_surface_features(state: MatcherState, visible: NDArray[np.uint8]) -> list[Features]:
    auxiliaries, scale = len(state.prepared.images), state.prepared.context.scale
    return [
        lambda: compute_shape_features(state.propagated, state.solution, scale),
        lambda: compute_agreement_features(state.propagated, state.solution, visible, auxiliaries),
        lambda: compute_information_features(state.solution, scale),
    ]


def _compute_planes(parts: list[Features], context: MatchContext) -> dict[str, Array]:
    """Return the planes of all parts by name."""
    computed = run_parallel([lambda part=part: dict(part()) for part in parts], context.threads)
    return {name: plane for planes in computed for name, plane in planes.items()}


def estimate_depth(state: MatcherState) -> DepthEstimate:
    """Return inverse depth, sigma, confidence and views of a matched surface.

    Sigma and confidence are predicted by small networks trained on simulated frames with known truth
    (docs/matching.md): the confidence is the probability of being right, sigma follows the median error. Without a
    candidate selection the initial features are used. The training frames have white noise; the effect of correlated
    noise is added to sigma afterwards.
    """
    (prediction, visible), measurable = run_pair(
        lambda: _predict(state), lambda: _mask_measurable(state), state.prepared.context.threads
    )
    confidence = 1 / (1 + np.exp(-prediction.logit))
    valid = np.isfinite(prediction.s) & (visible > 0) & measurable
    return DepthEstimate(
        s=prediction.s,
        sigma=inflate_sigma(np.exp(prediction.log_sigma), state),
        confidence=np.where(valid, confidence, 0).astype(np.float32),
        views=np.where(valid, visible, 0).astype(np.uint8),
    )


def _predict(state: MatcherState) -> tuple[Prediction, NDArray[np.uint8]]:
    """Return the networks' prediction for all pixels, and (H, W) the number of auxiliaries that see them."""
    s, context = state.solution.surface.s, state.prepared.context
    if state.selection is None:
        features, network = compute_initial_features(state), load_network("fast_confidence")
        outputs = network.evaluate(features.planes, context.kernels, context.threads)
        return Prediction(s, *outputs), features.visible
    features, inputs = compute_refined_features(state, state.selection)
    network = load_network("confidence")
    prediction = Prediction(s, *network.evaluate(features.planes, context.kernels, context.threads))
    return refine_uncertain_pixels(prediction, inputs), features.visible


def _mask_measurable(state: MatcherState) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels that have texture, or are in a filled disc, and that some view may confirm."""
    prepared = state.prepared
    window_px = scale_window(TEXTURE_PX, prepared.context.scale)[0]
    texture = compute_texture_ratio(fill_nan(prepared.core), prepared.noise.levels, window_px)
    textured = cv2.dilate(texture, np.ones((REACH_PX, REACH_PX), np.uint8)) > TEXTURE
    contradicted = (state.solution.used == 0) & (
        cv2.blur(fill_nan(state.propagated.cost, 1.0), (7, 7)) > CONTRADICTION
    )
    return np.isfinite(prepared.core) & (textured | state.filled) & ~contradicted
