"""The features of a surface's pixels that the networks of the confidence take, as planes (H, W) by name.

Before the candidate selection they are the initial features; they give the initial confidence. After it they are the
refined features: the initial ones, the roughness, the initial confidence around, the photo-consistency, and the
planes of reliable pixels around.

Steps and distances in px grow with the images. They are given in px of a grid of scale 1, so that the same shape has
the same features at any size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.confidence.inputs import ConfidenceInputs
from beltscape.stereo.multiview.frame.context import MatchContext
from beltscape.stereo.multiview.frame.parallel import run_parallel
from beltscape.stereo.multiview.frame.photometry import compute_box_variance
from beltscape.stereo.multiview.frame.windows import Windows
from beltscape.stereo.multiview.selection.photoconsistency import (
    PhotoConsistencyModel,
    compute_photometric_features,
)

Array = NDArray[np.floating]
Features = Iterator[tuple[str, Array]]
"""Planes (H, W) by name."""

_MOST_STEP_PX = 30.0
"""Limit of the height of a step."""
_MOST_OFFSET_PX = 5.0
"""Limit of a pixel's distance from the median of its neighbours."""
_NEAR_PX = (5, 15)
"""Sides, at scale 1, of the windows in which the roughness of a pixel itself is averaged."""
_WIDE_TILES = {41: 11, 101: 25}
"""Sides in px at scale 1, and in tiles, of the windows in which the roughness of the surroundings is averaged."""
_STEP_PX = 5
"""Window around a depth step that is left out of the roughness."""
_TILE_PX = 4
"""Side of the tiles that are averaged before the wide windows."""
_LEAST_SHARE, _LEAST = 1e-3, 0.01
"""Least share of measured pixels, and the offset before the logarithm, against division by and logarithm of zero."""
_MOST_DISTANCE_PX = 10.0
"""Limit of a pixel's distance from the reliable pixels' planes."""
_LEAST_WEIGHT = 1e-4
"""Least sum of weights, against division by zero."""
_STEEPEST = 1.5
"""Limit of the slopes of the reliable pixels' planes."""


def compute_initial_features(inputs: ConfidenceInputs) -> dict[str, Array]:
    """Return the features before candidate selection."""
    return _compute_planes(_list_surface_parts(inputs), inputs.prepared.context) | inputs.image_features


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
        *_list_surface_parts(inputs),
        partial(compute_photometric_features, inputs.surface, initial_confidence, consistency),
        partial(compute_reliability_features, inputs, initial_confidence),
        partial(compute_initial_confidence_features, initial_confidence, inputs.windows),
    ]
    planes = _compute_planes(parts, inputs.prepared.context) | inputs.image_features
    return planes | dict(compute_roughness_features(inputs, planes["slope deviation"]))


def _list_surface_parts(inputs: ConfidenceInputs) -> list[Callable[[], Features]]:
    computed = (
        compute_shape_features,
        compute_slope_deviations,
        compute_relief_features,
        compute_agreement_features,
    )
    return [partial(compute, inputs) for compute in computed]


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
        offset = np.clip((surface.s - plane_s) / windows.scale, -_MOST_DISTANCE_PX, _MOST_DISTANCE_PX)
        yield f"offset from reliable planes within {window_px}", offset
        yield f"reliable weight within {window_px}", np.asarray(total, np.float32)


def _compute_planes(parts: Sequence[Callable[[], Features]], context: MatchContext) -> dict[str, Array]:
    """Return the planes of all parts by name; the parts run side by side."""
    computed = run_parallel([lambda part=part: dict(part()) for part in parts], context.threads)
    return {name: plane for planes in computed for name, plane in planes.items()}


def compute_shape_features(inputs: ConfidenceInputs) -> Features:
    """Yield the shape of the surface: steps, slopes and bends."""
    s, surface = inputs.filled.s, inputs.filled
    px = np.float32(1 / inputs.windows.scale)
    yield "offset from median", np.minimum(px * np.abs(s - cv2.medianBlur(s, 5)), _MOST_OFFSET_PX)
    step_distance = px * _compute_step_distance(inputs.depth_steps)
    yield "step proximity", np.exp(-step_distance)
    yield "wide step proximity", np.exp(-step_distance / 4)
    yield "slope", np.minimum(np.hypot(surface.slope_u, surface.slope_v), 2)
    yield from _compute_bend_features(inputs)


def compute_agreement_features(inputs: ConfidenceInputs) -> Features:
    """Yield how well the images agree on the surface: variance, views, cost, margin and information."""
    yield "log sigma", 0.5 * np.log(np.clip(inputs.variance, 1e-6, 4.0))
    yield from _compute_view_features(inputs)
    yield "cost", inputs.cost
    yield "mean cost", np.asarray(cv2.blur(inputs.cost, (7, 7)), np.float32)
    yield "margin", inputs.margin
    yield "small margin", np.minimum(inputs.margin, 0.15)
    information = cv2.blur(inputs.information, inputs.windows.boxes[5])
    yield "log grid scale", np.full(information.shape, np.log(inputs.windows.scale), np.float32)
    yield "log mean information", np.log(np.maximum(information, 0) + np.float32(1e-3))


def compute_roughness_features(inputs: ConfidenceInputs, slope_deviation: Array) -> Features:
    """Yield the roughness of the material below the size of the matcher's windows.

    A single pixel does not show it. On rough material the windows of the fit disagree more often than noise
    explains, over a whole stone and over a region of stones. Features are means over the pixels away from depth
    steps at which a view agrees: of the windows' disagreement (its logarithm), of the slope deviation (H, W), which
    is one of the shape features, and of the logarithm of sigma.
    """
    boxes, scale = inputs.windows.boxes, inputs.windows.scale
    step = cv2.dilate(inputs.depth_steps.astype(np.uint8), np.ones(boxes[_STEP_PX], np.uint8))
    used = ((inputs.agreeing > 0) & (step == 0)).astype(np.float32)
    disagreement = used * inputs.disagreement
    for window_px in _NEAR_PX:
        box = boxes[window_px]
        mean = _compute_mean(cv2.blur(disagreement, box), cv2.blur(used, box))
        yield f"window disagreement within {window_px}", np.log(mean + np.float32(_LEAST))
    log_sigma = 0.5 * np.log(np.clip(inputs.filled_variance, 1e-8, 4.0))
    averaged = used, disagreement, used * slope_deviation, used * log_sigma
    tiles = [_average_tiles(plane, scale) for plane in averaged]
    for window_px, side in _WIDE_TILES.items():
        share, total, *others = (cv2.blur(plane, (side, side)) for plane in tiles)
        means = [
            np.log(_compute_mean(total, share) + np.float32(_LEAST)),
            *(_compute_mean(plane, share) for plane in others),
        ]
        names = "window disagreement", "slope deviation", "log sigma"
        for name, plane in zip(names, means, strict=True):
            yield f"{name} within {window_px}", cv2.resize(plane, used.shape[::-1])


def _compute_view_features(inputs: ConfidenceInputs) -> Features:
    visible, number, auxiliaries = inputs.visible, inputs.visible.astype(np.float32), inputs.auxiliaries
    yield "one view", (visible == 1).astype(np.float32)
    yield "two views", (visible == 2).astype(np.float32)
    yield "share of views", number / auxiliaries
    yield "mean views", np.asarray(cv2.blur(np.minimum(number, 4), (9, 9)), np.float32)
    yield "no agreeing view", (inputs.agreeing == 0).astype(np.float32)
    yield "share of disagreeing views", np.maximum(number - inputs.agreeing, 0) / auxiliaries


def _compute_bend_features(inputs: ConfidenceInputs) -> Features:
    """Yield the logarithm of the mean distance, px, of s from its window mean; it is small on planes."""
    s = inputs.filled.s
    for name, window_px, least in (("bend", 7, 0.001), ("wide bend", 25, 0.004)):
        box = inputs.windows.boxes[window_px]
        offset = np.minimum(np.abs(s - cv2.blur(s, box)), 1)
        yield name, np.log(cv2.blur(offset, box) + np.float32(least))


def compute_slope_deviations(inputs: ConfidenceInputs) -> Features:
    """Yield the logarithm of the slopes' standard deviation in a window: large at edges and on round flanks."""
    slopes = [np.clip(slope, -3, 3) for slope in (inputs.filled.slope_u, inputs.filled.slope_v)]
    for name, window_px in (("slope deviation", 5), ("wide slope deviation", 15)):
        box = inputs.windows.boxes[window_px]
        variance = compute_box_variance(slopes[0], box) + compute_box_variance(slopes[1], box)
        yield name, 0.5 * np.log(variance + np.float32(1e-8))


def compute_relief_features(inputs: ConfidenceInputs) -> Features:
    """Yield the last update, and how much nearer and farther the surface is around a pixel: what may occlude it."""
    s, px = inputs.filled.s, np.float32(1 / inputs.windows.scale)
    update = np.minimum(np.abs(s - inputs.propagated_s), 2)
    yield "last update", np.log(cv2.blur(update, inputs.windows.boxes[5]) + np.float32(0.002))
    for window_px in (5, 11, 21):
        square = np.ones(inputs.windows.boxes[window_px], np.uint8)
        yield f"nearer within {window_px}", np.minimum(px * (cv2.dilate(s, square) - s), _MOST_STEP_PX)
        yield f"farther within {window_px}", np.minimum(px * (s - cv2.erode(s, square)), _MOST_STEP_PX)


def _compute_step_distance(depth_steps: NDArray[np.bool_]) -> Array:
    """Return the (H, W) distance to the nearest depth step of the surface, px."""
    distance = cv2.distanceTransform((~depth_steps).astype(np.uint8), cv2.DIST_L2, 5)
    # without any step OpenCV returns nearly the largest number
    return np.minimum(np.asarray(distance, np.float32), 1e4)


def _compute_mean(total: Array, share: Array) -> Array:
    return total / np.maximum(share, np.float32(_LEAST_SHARE))


def _average_tiles(plane: Array, scale: float) -> Array:
    """Return means over tiles."""
    side = max(1, int(_TILE_PX * scale))
    height, width = plane.shape
    size = max(1, width // side), max(1, height // side)
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)
