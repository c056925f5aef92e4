"""Tie points: textured points of the core image and their positions in the auxiliary images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image, to_grey
from beltscape.core.geometry.camera import Camera
from beltscape.stereo.multiview.frame.photometry import compute_texture_ratio, estimate_noise_variance

Array = NDArray[np.float64]

MAX_POINTS = 300
"""More points take longer and change the medians by less than the matching's own bias."""
_DETECTION_WIDTH_PX = 620
"""Corners are detected in an image of about this width: four times as fast as in one of 1224 px."""
_QUALITY = 0.01
"""Least corner strength as a share of the greatest (OpenCV's ``goodFeaturesToTrack``)."""
_TEXTURE = 6.0
"""Least variance of a patch over that of the noise; below it one match in five was wrong on dark belts."""
_TEXTURE_PX = 9
"""Side of the window in which the texture is compared with the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class TiePoints:
    """Points of the core image and their correspondences."""

    core_px: Array
    """(N, 2) on the core's undistorted grid."""
    inverse_depth: Array
    """(N,) 1/mm at which the search began; the residuals do not depend on it."""
    observed_px: Mapping[str, Array]
    """By auxiliary: (N, 2) position in its distorted image; NaN: not found."""
    searched: Mapping[str, NDArray[np.bool_]]
    """By auxiliary: (N,) whether the point was searched in its image."""
    pixel_scale: float = 1.0
    """Pixel of the images in which the points were matched, in px of the rig's images."""


def join_tie_points(frames: Sequence[TiePoints]) -> TiePoints:
    """Return the tie points of several frames of one rig; a camera was not searched in a frame without it."""
    names = tuple(dict.fromkeys(name for each in frames for name in each.observed_px))

    def observed(each: TiePoints, name: str) -> Array:
        return each.observed_px.get(name, np.full(each.core_px.shape, np.nan))

    def searched(each: TiePoints, name: str) -> NDArray[np.bool_]:
        return each.searched.get(name, np.zeros(len(each.core_px), np.bool_))

    return TiePoints(
        np.concatenate([each.core_px for each in frames]),
        np.concatenate([each.inverse_depth for each in frames]),
        {name: np.concatenate([observed(each, name) for each in frames]) for name in names},
        {name: np.concatenate([searched(each, name) for each in frames]) for name in names},
        frames[0].pixel_scale,
    )


def detect_textured_points(image: Image, camera: Camera, *, max_points: int = MAX_POINTS) -> Array:
    """Return (N, 2) px on the core's undistorted grid: corners stronger than the noise, the strongest first."""
    level = to_grey(image) if image.dtype == np.uint8 else to_grey(image) / np.float32(257.0)
    shrink = max(1, round(level.shape[1] / _DETECTION_WIDTH_PX))
    size = (level.shape[1] // shrink, level.shape[0] // shrink)
    small = cv2.resize(level[: size[1] * shrink, : size[0] * shrink], size, interpolation=cv2.INTER_AREA)
    small = np.asarray(small, np.float32)
    texture = compute_texture_ratio(small, estimate_noise_variance(small), _TEXTURE_PX)
    distance = max(5.0, 0.5 * float(np.sqrt(size[0] * size[1] / max_points)))
    # the square root of the levels gives dark regions the same weight as bright ones
    root = np.sqrt(np.maximum(small, 0) + np.float32(1.0))
    mask = (texture >= _TEXTURE).astype(np.uint8)
    corners = cv2.goodFeaturesToTrack(root, 4 * max_points, _QUALITY, distance, mask=mask)
    if corners is None:
        return np.empty((0, 2))
    pixels = _select_evenly(corners[:, 0].astype(np.float64), size, max_points) * shrink + (shrink - 1) / 2
    undistorted = camera.undistort(pixels) * camera.focal_px + camera.center_px
    inside = ((undistorted >= 0) & (undistorted <= np.array(camera.size_px) - 1)).all(axis=1)
    return undistorted[inside]


def _select_evenly(corners: Array, size_px: tuple[int, int], max_points: int) -> Array:
    """Return at most ``max_points`` corners, with about the same number from each of the image's 8 × 6 cells."""
    cell = (corners / size_px * (8, 6)).astype(int)
    number = cell[:, 0] + 8 * cell[:, 1]
    order = np.argsort(number, kind="stable")
    start = np.searchsorted(number[order], number[order])
    rank = np.empty(len(corners), int)
    rank[order] = np.arange(len(corners)) - start
    return corners[np.argsort(rank, kind="stable")[:max_points]]
