"""What to believe of a surface: its last nearness, sigma, confidence and the number of views, pixel by pixel."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.multiview.confidence.correlated_noise import inflate_sigma
from beltscape.stereo.multiview.confidence.features import agreement_features, shape_features
from beltscape.stereo.multiview.confidence.refined_features import (
    initial_confidence_features,
    photometric_features,
    reliability_features,
)
from beltscape.stereo.multiview.confidence.refiner import (
    Prediction,
    RefinementInputs,
    refine_uncertain_pixels,
)
from beltscape.stereo.multiview.confidence.roughness import roughness_features
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.parallel import run_pair, run_parallel
from beltscape.stereo.multiview.frame.photometry import texture_over_noise
from beltscape.stereo.multiview.frame.visibility import compute_visibility, count_visible_views
from beltscape.stereo.multiview.frame.windows import scaled_window
from beltscape.stereo.multiview.networks import load_network
from beltscape.stereo.multiview.selection.candidates import Selection
from beltscape.stereo.multiview.selection.photoconsistency import PhotoConsistencyModel
from beltscape.stereo.multiview.state import MatcherState

Array = NDArray[np.floating]

REACH_PX = 9
"""A flat pixel may be held by texture so far away that its fit's window still touches it."""
TEXTURE, TEXTURE_PX = 2.0, 9
"""Variance over the noise's up to which a window of so many px, at scale 1, has no texture."""
CONTRADICTION = 0.4
"""Mean dissimilarity from which on views that do not agree contradict the surface."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthEstimate:
    """Per pixel of the matcher's grid."""

    s: Array
    """(H, W) nearness, where doubtful pixels belong."""
    sigma: Array
    """(H, W) one standard deviation of s, px."""
    confidence: Array
    """(H, W) probability that the pixel is not a false surface."""
    views: NDArray[np.uint8]
    """(H, W) auxiliaries that see the pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class PixelFeatures:
    """Everything that speaks for and against a refined surface's pixels."""

    planes: dict[str, Array]
    """(H, W) by name."""
    seen: NDArray[np.uint8]
    """(H, W) how many auxiliaries see the surface."""


def initial_features(match: MatcherState, scale: float, kernels: Kernels, threads: int) -> PixelFeatures:
    """What the matching itself says; windows grow with ``scale``."""
    prepared, surface = match.prepared, match.refined.surface
    seen = count_visible_views(surface.s, prepared.views, prepared.sizes, kernels, threads)
    return PixelFeatures(_joined(_of_the_surface(match, seen, scale), threads) | match.light, seen)


def with_initial_confidence(
    first: PixelFeatures, scale: float, kernels: Kernels, threads: int
) -> dict[str, Array]:
    """A first look's planes (H, W) by name, with the impression that they make."""
    (impression,) = load_network("impression").answers(first.planes, kernels, threads)
    return first.planes | dict(initial_confidence_features(impression, scale))


def refined_features(
    match: MatcherState, contested: Selection, scale: float, kernels: Kernels, threads: int
) -> tuple[PixelFeatures, RefinementInputs]:
    """Also what the levels themselves say, and the impression of the state before; and a scrutiny by all of it."""
    prepared, surface, impression = match.prepared, match.refined.surface, contested.impression
    seen, buffers = compute_visibility(surface.s, prepared.views, prepared.sizes, kernels, threads)
    likeness = PhotoConsistencyModel(prepared, contested.brightness, buffers, kernels)
    parts = [
        lambda: photometric_features(surface, impression, likeness, threads),
        lambda: reliability_features(surface, impression, scale),
        lambda: initial_confidence_features(impression, scale),
    ]
    planes = _joined([*_of_the_surface(match, seen, scale), *parts], threads) | match.light
    planes |= dict(roughness_features(match.refined, planes["turn"], scale))
    return PixelFeatures(planes, seen), RefinementInputs.of(planes, surface, likeness, scale)


Part = Callable[[], Iterator[tuple[str, Array]]]


def _of_the_surface(match: MatcherState, seen: NDArray[np.uint8], scale: float) -> list[Part]:
    auxiliaries = len(match.prepared.images)
    return [
        lambda: shape_features(match.chosen, match.refined, scale),
        lambda: agreement_features(match.chosen, match.refined, auxiliaries, seen, scale),
    ]


def _joined(parts: list[Part], threads: int) -> dict[str, Array]:
    """All parts' planes by name."""
    found = run_parallel([lambda part=part: dict(part()) for part in parts], threads)
    return {name: plane for planes in found for name, plane in planes.items()}


def estimate_depth(match: MatcherState, scale: float, kernels: Kernels, threads: int) -> DepthEstimate:
    """Sigma and confidence of a surface, on a grid ``scale`` times finer than `windows` tells sizes for.

    Both are a small network's answers to what the evidence lists, fitted to simulated frames with known truth
    (docs/matching.md): confidence to what is right, sigma to the median error. Where no pixel was looked at again
    the first look is the last. Those frames have white noise; correlated noise adds to sigma afterwards.
    """
    (told, seen), textured = run_pair(
        lambda: _thought(match, scale, kernels, threads), lambda: _said(match, scale), threads
    )
    confidence = 1 / (1 + np.exp(-told.logit))
    trusted = np.isfinite(told.s) & (seen > 0) & textured
    return DepthEstimate(
        s=told.s,
        sigma=inflate_sigma(np.exp(told.log_sigma), match, kernels, threads),
        confidence=np.where(trusted, confidence, 0).astype(np.float32),
        views=np.where(trusted, seen, 0).astype(np.uint8),
    )


def _thought(
    match: MatcherState, scale: float, kernels: Kernels, threads: int
) -> tuple[Prediction, NDArray[np.uint8]]:
    """What the networks tell of all pixels, and (H, W) how many auxiliaries see them."""
    s = match.refined.surface.s
    if match.contested is None:
        found = initial_features(match, scale, kernels, threads)
        return Prediction(s, *load_network("glance").answers(found.planes, kernels, threads)), found.seen
    found, scrutiny = refined_features(match, match.contested, scale, kernels, threads)
    thought = Prediction(s, *load_network("belief").answers(found.planes, kernels, threads))
    return refine_uncertain_pixels(thought, scrutiny, threads), found.seen


def _said(match: MatcherState, scale: float) -> NDArray[np.bool_]:
    """(H, W) where the images say anything: texture above the noise, or a disc's rim, and not that nothing fits."""
    prepared = match.prepared
    texture = texture_over_noise(
        fill_nan(prepared.core), prepared.noise.levels, scaled_window(TEXTURE_PX, scale)[0]
    )
    textured = cv2.dilate(texture, np.ones((REACH_PX, REACH_PX), np.uint8)) > TEXTURE
    contradicted = (match.refined.used == 0) & (
        cv2.blur(fill_nan(match.chosen.cost, 1.0), (7, 7)) > CONTRADICTION
    )
    return np.isfinite(prepared.core) & (textured | match.continued) & ~contradicted
