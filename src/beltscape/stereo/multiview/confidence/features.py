"""The features of a surface's pixels that the networks of the confidence take, as planes (H, W) by name.

Before the candidate selection they are the initial features; they give the initial confidence. After it they are the
refined features: the initial ones, the roughness, the initial confidence around, the photo-consistency, and the
planes of reliable pixels around.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.confidence.inputs import ConfidenceInputs
from beltscape.stereo.multiview.confidence.surface_features import (
    Features,
    compute_agreement_features,
    compute_relief_features,
    compute_roughness_features,
    compute_shape_features,
    compute_slope_deviations,
)
from beltscape.stereo.multiview.frame.context import MatchContext
from beltscape.stereo.multiview.frame.parallel import run_parallel
from beltscape.stereo.multiview.frame.windows import Windows
from beltscape.stereo.multiview.selection.photoconsistency import (
    PhotoConsistencyModel,
    compute_photometric_features,
)

Array = NDArray[np.floating]

_SURFACE_FEATURES = (
    compute_shape_features,
    compute_agreement_features,
    compute_slope_deviations,
    compute_relief_features,
)
"""Computed side by side, the longest first."""
_MOST_OFFSET_PX = 10.0
"""Limit of a pixel's distance from the reliable pixels' planes."""
_LEAST_WEIGHT = 1e-4
"""Least sum of weights, against division by zero."""
_STEEPEST = 1.5
"""Limit of the slopes of the reliable pixels' planes."""


def compute_initial_features(inputs: ConfidenceInputs) -> dict[str, Array]:
    """Return the features before candidate selection."""
    parts = [partial(compute, inputs) for compute in _SURFACE_FEATURES]
    return _compute_planes(parts, inputs.prepared.context) | inputs.image_features


def compute_selection_features(inputs: ConfidenceInputs) -> dict[str, Array]:
    """Return the initial features with the initial confidence, its means and its minimum around."""
    features, context = compute_initial_features(inputs), inputs.prepared.context
    network = load_network("initial_confidence")
    (logit,) = network.evaluate(features, context.kernels, context.threads)
    return features | dict(compute_initial_confidence_features(logit, context.windows))


def compute_refined_features(
    inputs: ConfidenceInputs, initial_confidence: Array, consistency: PhotoConsistencyModel
) -> dict[str, Array]:
    """Return the features after candidate selection, which gave the initial confidence (H, W), a logit."""
    parts: list[Callable[[], Features]] = [
        *(partial(compute, inputs) for compute in _SURFACE_FEATURES),
        partial(compute_photometric_features, inputs.surface, initial_confidence, consistency),
        partial(compute_reliability_features, inputs, initial_confidence),
        partial(compute_initial_confidence_features, initial_confidence, inputs.windows),
    ]
    planes = _compute_planes(parts, inputs.prepared.context) | inputs.image_features
    return planes | dict(compute_roughness_features(inputs, planes["slope deviation"]))


def compute_initial_confidence_features(logit: Array, windows: Windows) -> Features:
    """Yield the initial confidence (H, W), logit, its means and its minimum around."""
    logit = np.clip(logit, -8, 8).astype(np.float32)
    yield "initial confidence", logit
    for window_px in (3, 7, 15):
        mean = cv2.blur(logit, windows.boxes[window_px])
        yield f"initial confidence within {window_px}", np.asarray(mean, np.float32)
    lowest = cv2.erode(logit, np.ones(windows.boxes[3], np.uint8))
    yield "lowest initial confidence within 3", np.asarray(lowest, np.float32)


def compute_reliability_features(inputs: ConfidenceInputs, initial_confidence: Array) -> Features:
    """Yield the distance from the planes of reliable pixels around (px at scale 1), and their weight."""
    windows, surface = inputs.windows, inputs.filled
    weight = (1 / (1 + np.exp(-np.clip(initial_confidence, -8, 8).astype(np.float32)))) ** 3
    height, width = weight.shape
    u, v = np.arange(width, dtype=np.float32)[None], np.arange(height, dtype=np.float32)[:, None]
    slope_u, slope_v = (np.clip(slope, -_STEEPEST, _STEEPEST) for slope in (surface.slope_u, surface.slope_v))
    # a plane's value at p is that at the origin + slope · p, so means of planes are planes
    at_origin = surface.s - slope_u * u - slope_v * v
    weighted = [weight, weight * at_origin, weight * slope_u, weight * slope_v]
    for window_px in (7, 15):
        total, constant, across, down = (cv2.blur(x, windows.boxes[window_px]) for x in weighted)
        plane_s = (constant + across * u + down * v) / np.maximum(total, _LEAST_WEIGHT)
        offset = np.clip((surface.s - plane_s) / windows.scale, -_MOST_OFFSET_PX, _MOST_OFFSET_PX)
        yield f"offset from reliable planes within {window_px}", offset
        yield f"reliable weight within {window_px}", np.asarray(total, np.float32)


def _compute_planes(parts: Sequence[Callable[[], Features]], context: MatchContext) -> dict[str, Array]:
    """Return the planes of all parts by name; the parts run side by side."""
    computed = run_parallel([lambda part=part: dict(part()) for part in parts], context.threads)
    return {name: plane for planes in computed for name, plane in planes.items()}
