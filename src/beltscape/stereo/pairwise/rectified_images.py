"""The images of a rectified pair."""

from __future__ import annotations

from dataclasses import dataclass

import cv2

from beltscape.core.frames import FrameSet, Image
from beltscape.stereo.pairwise.rectification import RectifiedPair


@dataclass(frozen=True, slots=True, eq=False)
class RectifiedImages:
    """A rectified pair of one frame."""

    pair: RectifiedPair
    core: Image
    auxiliary: Image


def rectify_images(frame_set: FrameSet, pair: RectifiedPair) -> RectifiedImages:
    """Return both images of a pair on their common rows, interpolated once from the distorted images."""
    core = cv2.remap(frame_set.images[pair.core], pair.core_map, None, cv2.INTER_CUBIC)
    auxiliary = cv2.remap(frame_set.images[pair.auxiliary], pair.aux_map, None, cv2.INTER_CUBIC)
    return RectifiedImages(pair, core, auxiliary)
