"""Search for mirrored or turned images: the frame fits the rig when they are flipped back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.core.frames import Image
from beltscape.stereo.consistency.diagnosis.fitting_points import FittingPoints
from beltscape.stereo.consistency.rig_consistency import RigConsistency

Flip = Literal["left to right", "upside down", "by 180°"]
_STEPS: dict[Flip, tuple[int, int]] = {"left to right": (1, -1), "upside down": (-1, 1), "by 180°": (-1, -1)}
"""Steps of rows and columns that undo each flip."""


_WELL_CONFIRMED = 2
"""With this number of sound auxiliaries, the core's image is not flipped."""
_GAIN = 1.3
"""Least ratio of the points that fit after the flip to those that fit before: where all cameras look in parallel, a
flip of all images leaves corresponding rows together."""
_SHARE = 0.4
"""A flipped image fits if it finds this share of the points of the best auxiliary."""


@dataclass(frozen=True, slots=True)
class Mirroring:
    """Cameras whose images are mirrored or turned by half a turn."""

    cameras: tuple[str, ...]
    flip: Flip


def find_mirroring(fitting: FittingPoints, consistency: RigConsistency) -> Mirroring | None:
    """Return the cameras whose flipped images fit the rig: all, the core, or one unmatched auxiliary.

    The result is None if a knock of one camera explains the frame, or if no image is unmatched: hardly any point of a
    mirrored image lies where the rig predicts it.
    """
    change = consistency.pose_change
    if change is not None and change.is_plausible:
        return None
    core, names = fitting.rig.core, fitting.auxiliaries
    if len(consistency.find_auxiliaries("sound")) >= _WELL_CONFIRMED:
        suspects = [(name,) for name in consistency.find_auxiliaries("unmatched")]
    else:
        suspects = [(core, *names), (core,), *((name,) for name in consistency.inconsistent)]
    before = fitting.unchanged if suspects else {}
    best: Mirroring | None = None
    most = _GAIN * sum(before.values()) + 1
    for cameras in suspects:
        affected = names if core in cameras else cameras
        for flip in _STEPS:
            images = fitting.frame_set.images
            points = fitting.count_with({name: _flip_image(images[name], flip) for name in cameras})
            total = sum(points.values())
            if total >= most and all(
                points[n] > max(before[n], _SHARE * max(points.values())) for n in affected
            ):
                best, most = Mirroring(cameras, flip), total
    return best


def _flip_image(image: Image, flip: Flip) -> Image:
    rows, columns = _STEPS[flip]
    return np.ascontiguousarray(image[::rows, ::columns])
