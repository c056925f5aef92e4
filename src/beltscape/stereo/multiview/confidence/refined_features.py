"""Refined features of a pixel: initial confidence, photo-consistency, and the planes of reliable pixels around."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.selection.candidates import PhotoConsistency
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.surface import Surface
from beltscape.stereo.multiview.frame.windows import scale_window
from beltscape.stereo.multiview.selection.photoconsistency import (
    PhotoConsistencyModel,
    compute_photo_consistency_features,
)

Array = NDArray[np.floating]

_MOST_OFFSET_PX = 10.0
"""Limit of a pixel's distance from the reliable pixels' planes."""
_LEAST_WEIGHT = 1e-4
"""Least sum of weights, against division by zero."""
_STEEPEST = 1.5
"""Limit of the slopes of the reliable pixels' planes."""
PHOTOMETRIC_LIMIT = 3.5
"""Initial confidence (logit) from which on the photo-consistency is not evaluated."""


def compute_initial_confidence_features(logit: Array, scale: float) -> Iterator[tuple[str, Array]]:
    """Yield the initial confidence (H, W), logit, its means and its minimum around, by name."""
    logit = np.clip(logit, -8, 8).astype(np.float32)
    yield "initial confidence", logit
    for window_px in (3, 7, 15):
        mean = cv2.blur(logit, scale_window(window_px, scale))
        yield f"initial confidence within {window_px}", np.asarray(mean, np.float32)
    lowest = cv2.erode(logit, np.ones(scale_window(3, scale), np.uint8))
    yield "lowest initial confidence within 3", np.asarray(lowest, np.float32)


def compute_photometric_features(
    surface: Surface, initial_confidence: Array, consistency: PhotoConsistencyModel
) -> Iterator[tuple[str, Array]]:
    """Yield the photo-consistency (H, W) by name, evaluated below `PHOTOMETRIC_LIMIT`.

    The other pixels count as consistent and visible in no view.
    """
    prepared = consistency.prepared
    auxiliaries = len(prepared.images)
    pixels = np.nonzero(initial_confidence < PHOTOMETRIC_LIMIT)
    if not len(pixels[0]):
        pixels = np.zeros(1, int), np.zeros(1, int)
    s, slope_u, slope_v = (plane[pixels][None] for plane in (surface.s, surface.slope_u, surface.slope_v))
    evaluated = consistency.evaluate(pixels, s, (slope_u, slope_v), prepared.context.threads)
    consistent = PhotoConsistency(*(np.zeros((1, 1), np.float32) for _ in evaluated))
    elsewhere = dict(compute_photo_consistency_features(consistent, auxiliaries))
    for name, values in compute_photo_consistency_features(evaluated, auxiliaries):
        plane = np.full(surface.s.shape, elsewhere[name].item(), np.float32)
        plane[pixels] = values[0]
        yield name, plane


def compute_reliability_features(
    surface: Surface, initial_confidence: Array, scale: float
) -> Iterator[tuple[str, Array]]:
    """Yield (H, W) by name: distance from the planes of reliable pixels around (px at scale 1), and their weight."""
    weight = (1 / (1 + np.exp(-np.clip(initial_confidence, -8, 8).astype(np.float32)))) ** 3
    height, width = weight.shape
    u, v = np.arange(width, dtype=np.float32)[None], np.arange(height, dtype=np.float32)[:, None]
    s, slope_u, slope_v = (fill_nan(plane) for plane in (surface.s, surface.slope_u, surface.slope_v))
    slope_u, slope_v = np.clip(slope_u, -_STEEPEST, _STEEPEST), np.clip(slope_v, -_STEEPEST, _STEEPEST)
    # a plane's value at p is that at the origin + slope · p, so means of planes are planes
    at_origin = s - slope_u * u - slope_v * v
    weighted = [weight, weight * at_origin, weight * slope_u, weight * slope_v]
    for window_px in (7, 15):
        side = scale_window(window_px, scale)
        total, constant, across, down = (cv2.blur(x, side) for x in weighted)
        plane_s = (constant + across * u + down * v) / np.maximum(total, _LEAST_WEIGHT)
        offset = np.clip((s - plane_s) / scale, -_MOST_OFFSET_PX, _MOST_OFFSET_PX)
        yield f"offset from reliable planes within {window_px}", offset
        yield f"reliable weight within {window_px}", np.asarray(total, np.float32)
