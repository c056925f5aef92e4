"""What a closer look adds to the evidence: the levels themselves, and what the trusted pixels around say."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.candidates import PhotoConsistency
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.surface import Surface
from beltscape.stereo.multiview.frame.windows import scaled_window
from beltscape.stereo.multiview.selection.photoconsistency import (
    PhotoConsistencyModel,
    photo_consistency_features,
)

Array = NDArray[np.floating]

_MOST_OFF_PX = 10.0
"""No surface counts as farther off the trusted ones'."""
_LEAST_TRUST = 1e-4
_STEEPEST = 1.5
PHOTOMETRIC_LIMIT = 3.5
"""A logit from which on nobody asks the levels."""


def initial_confidence_features(impression: Array, scale: float) -> Iterator[tuple[str, Array]]:
    """A first impression (H, W), logit, and that of the surroundings."""
    impression = np.clip(impression, -8, 8).astype(np.float32)
    yield "impression", impression
    for window_px in (3, 7, 15):
        yield (
            f"impression within {window_px}",
            np.asarray(cv2.blur(impression, scaled_window(window_px, scale)), np.float32),
        )
    worst = cv2.erode(impression, np.ones(scaled_window(3, scale), np.uint8))
    yield "worst impression within 3", np.asarray(worst, np.float32)


def photometric_features(
    surface: Surface, impression: Array, likeness: PhotoConsistencyModel, threads: int
) -> Iterator[tuple[str, Array]]:
    """How like the images are at pixels that are not beyond doubt; the others count as alike, and seen by none."""
    auxiliaries = len(likeness.prepared.images)
    at = np.nonzero(impression < PHOTOMETRIC_LIMIT)
    if not len(at[0]):
        at = np.zeros(1, int), np.zeros(1, int)
    like = likeness.of(
        at, *(plane[at][None] for plane in (surface.s, surface.slope_u, surface.slope_v)), threads
    )
    alike = PhotoConsistency(*(np.zeros((1, 1), np.float32) for _ in like))
    elsewhere = dict(photo_consistency_features(alike, auxiliaries))
    for name, told in photo_consistency_features(like, auxiliaries):
        plane = np.full(surface.s.shape, elsewhere[name].item(), np.float32)
        plane[at] = told[0]
        yield name, plane


def reliability_features(surface: Surface, impression: Array, scale: float) -> Iterator[tuple[str, Array]]:
    """How far a pixel lies off the planes of the trusted around it, px of a grid of scale 1."""
    trust = (1 / (1 + np.exp(-np.clip(impression, -8, 8).astype(np.float32)))) ** 3
    height, width = trust.shape
    u, v = np.arange(width, dtype=np.float32)[None], np.arange(height, dtype=np.float32)[:, None]
    s, slope_u, slope_v = (fill_nan(plane) for plane in (surface.s, surface.slope_u, surface.slope_v))
    slope_u, slope_v = np.clip(slope_u, -_STEEPEST, _STEEPEST), np.clip(slope_v, -_STEEPEST, _STEEPEST)
    # a plane's value at p is that at the origin + slope · p: means of planes are planes
    at_origin = s - slope_u * u - slope_v * v
    weighted = [trust, trust * at_origin, trust * slope_u, trust * slope_v]
    for window_px in (7, 15):
        side = scaled_window(window_px, scale)
        total, constant, across, down = (cv2.blur(x, side) for x in weighted)
        told = (constant + across * u + down * v) / np.maximum(total, _LEAST_TRUST)
        yield f"off the trusted within {window_px}", np.clip((s - told) / scale, -_MOST_OFF_PX, _MOST_OFF_PX)
        yield f"trust within {window_px}", np.asarray(total, np.float32)
