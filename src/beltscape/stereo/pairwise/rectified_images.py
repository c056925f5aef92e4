"""The images of a rectified pair, and their row error."""

from __future__ import annotations

from dataclasses import dataclass

import cv2

from beltscape.core.frames import FrameSet, Image
from beltscape.stereo.pairwise.contrast import quantise_root
from beltscape.stereo.pairwise.rectification import RectifiedPair
from beltscape.stereo.pairwise.row_error import RowError, measure_row_error


@dataclass(frozen=True, slots=True, eq=False)
class RectifiedImages:
    """A rectified pair of one frame."""

    pair: RectifiedPair
    core: Image
    auxiliary: Image
    rows: RowError


def rectify_images(frame_set: FrameSet, pair: RectifiedPair) -> RectifiedImages:
    """Return both images of a pair on their common rows, interpolated once from the distorted images."""
    core = cv2.remap(frame_set.images[pair.core], pair.core_map, None, cv2.INTER_CUBIC)
    auxiliary = cv2.remap(frame_set.images[pair.auxiliary], pair.aux_map, None, cv2.INTER_CUBIC)
    left, right = (quantise_root(image) for image in (core, auxiliary))
    return RectifiedImages(pair, core, auxiliary, measure_row_error(left, right, pair.disparities))
