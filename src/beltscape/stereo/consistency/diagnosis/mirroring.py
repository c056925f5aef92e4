"""Search for mirrored or turned images: the frame fits the rig when they are flipped back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.diagnosis.exchange import (
    POINTS,
    count_fitting_points,
    list_imaged_auxiliaries,
)
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.consistency.tie_points.tie_points import detect_textured_points

Flip = Literal["left to right", "upside down", "by 180°"]
_STEPS: dict[Flip, tuple[int, int]] = {"left to right": (1, -1), "upside down": (-1, 1), "by 180°": (-1, -1)}
"""Steps of rows and columns that undo each flip."""


_WELL_CONFIRMED = 2
"""With this number of sound auxiliaries, the core's image is not flipped."""
_SHARE = 0.4
"""A flipped image fits if it finds this share of the points of the best auxiliary."""


@dataclass(frozen=True, slots=True)
class Mirroring:
    """Cameras whose images are mirrored or turned by half a turn."""

    cameras: tuple[str, ...]
    flip: Flip


def find_mirroring(frame_set: FrameSet, rig: Rig, consistency: RigConsistency) -> Mirroring | None:
    """Return the cameras whose flipped images fit the rig: all, the core, or one unmatched auxiliary.

    The result is None if a knock of one camera explains the frame, or if no image is unmatched: hardly any point of a
    mirrored image lies where the rig predicts it.
    """
    change = consistency.pose_change
    if change is not None and change.is_plausible:
        return None
    names = list_imaged_auxiliaries(frame_set, rig)
    if len(consistency.find_auxiliaries("sound")) >= _WELL_CONFIRMED:
        suspects = [(name,) for name in consistency.find_auxiliaries("unmatched")]
    else:
        suspects = [(rig.core, *names), (rig.core,), *((name,) for name in consistency.inconsistent)]
    before = _count(frame_set, rig, names) if suspects else {}
    best: Mirroring | None = None
    most = sum(before.values())
    for cameras in suspects:
        affected = names if rig.core in cameras else cameras
        for flip in _STEPS:
            points = _count(_flip_images(frame_set, cameras, flip), rig, names)
            total = sum(points.values())
            if total > most and all(
                points[n] > max(before[n], _SHARE * max(points.values())) for n in affected
            ):
                best, most = Mirroring(cameras, flip), total
    return best


def _flip_images(frame_set: FrameSet, cameras: tuple[str, ...], flip: Flip) -> FrameSet:
    rows, columns = _STEPS[flip]

    def turn(image: Image) -> Image:
        return np.ascontiguousarray(image[::rows, ::columns])

    images = {name: turn(image) if name in cameras else image for name, image in frame_set.images.items()}
    return replace(frame_set, images=images)


def _count(frame_set: FrameSet, rig: Rig, names: tuple[str, ...]) -> dict[str, int]:
    """Return by auxiliary the number of points that fit the rig."""
    points_px = detect_textured_points(frame_set.images[rig.core], rig.core_camera, max_points=POINTS)
    return count_fitting_points(frame_set, rig, names, points_px)
