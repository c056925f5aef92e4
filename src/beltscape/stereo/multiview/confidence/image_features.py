"""Features of the core's image, which do not depend on the surface: brightness, contrast and texture."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.photometry import (
    compute_box_moments,
    compute_local_variance,
    compute_texture_ratio,
)

Array = NDArray[np.floating]

_WIDE_PX = 31
"""Side of the window, several dots wide, with whose brightness and contrast a pixel's own are compared."""
REACH_PX = 9
"""Window around texture in which pixels without texture are measured, since the fit's window includes the texture."""
TEXTURE, TEXTURE_PX = 2.0, 9
"""Ratio of the variance to the noise's up to which a window has no texture, and its side in px at scale 1."""


class ImageFeatures(NamedTuple):
    """Features of the pixels of the core's image, and where it has texture."""

    planes: dict[str, Array]
    """(H, W) features by name."""
    textured: NDArray[np.bool_]
    """(H, W) pixels inside the image near which there is texture."""


def compute_image_features(prepared: PreparedFrame) -> ImageFeatures:
    """Return the features of the core's image, and where it has texture."""
    return ImageFeatures(dict(_compare_with_neighbourhood(prepared)), _mask_textured(prepared))


def _compare_with_neighbourhood(prepared: PreparedFrame) -> Iterator[tuple[str, Array]]:
    """Yield brightness and contrast relative to the surroundings: both are lower outside the projector's light."""
    boxes = prepared.context.windows.boxes
    core = np.maximum(prepared.filled_core, 0)  # splines undershoot
    noise = np.float32(prepared.noise.levels)
    wide_mean, wide_variance = compute_box_moments(core, boxes[_WIDE_PX])
    brightness, contrast = wide_mean + 1, wide_variance + noise
    for window_px in (5, 11):
        mean, variance = compute_box_moments(core, boxes[window_px])
        yield f"relative brightness within {window_px}", np.log((mean + 1) / brightness)
        yield f"relative contrast within {window_px}", np.log((variance + noise) / contrast)
    yield "log texture over noise", np.log((compute_local_variance(core) + np.float32(1e-3)) / noise)


def _mask_textured(prepared: PreparedFrame) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels within `REACH_PX` of texture."""
    side = prepared.context.windows.boxes[TEXTURE_PX][0]
    texture = compute_texture_ratio(prepared.filled_core, prepared.noise.levels, side)
    return np.asarray(cv2.dilate(texture, np.ones((REACH_PX, REACH_PX), np.uint8)) > TEXTURE)
