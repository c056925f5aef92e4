"""Search for mirrored or turned images: the frame fits the rig when they are flipped back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.exchange import (
    GAIN,
    POINTS,
    count_fitting_points,
    list_imaged_auxiliaries,
)
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.consistency.tie_points import detect_textured_points

Flip = Literal["left to right", "upside down", "by 180°"]
_STEPS: dict[Flip, tuple[int, int]] = {"left to right": (1, -1), "upside down": (-1, 1), "by 180°": (-1, -1)}
"""Steps of rows and columns that undo each flip."""


@dataclass(frozen=True, slots=True)
class Mirroring:
    """Cameras whose images are mirrored or turned by half a turn."""

    cameras: tuple[str, ...]
    flip: Flip


def find_mirroring(frame_set: FrameSet, rig: Rig, consistency: RigConsistency) -> Mirroring | None:
    """Return the cameras whose flipped images fit the rig best: all, the core, or one inconsistent auxiliary.

    The result is None if nothing is unmatched: a mirrored image shows hardly any point where the rig predicts it.
    """
    has_sound = bool(consistency.find_auxiliaries("sound"))
    if has_sound and not consistency.find_auxiliaries("unmatched"):
        return None
    names = list_imaged_auxiliaries(frame_set, rig)
    suspects: list[tuple[str, ...]] = [(name,) for name in consistency.inconsistent]
    if len(suspects) > 1:
        suspects = [(rig.core, *names), (rig.core,), *suspects]
    best: Mirroring | None = None
    most = 1.0 + GAIN * sum(_count(frame_set, rig, names).values())
    for cameras in suspects:
        affected = names if rig.core in cameras else cameras
        for flip in _STEPS:
            points = _count(_flip_images(frame_set, cameras, flip), rig, names)
            if all(points[name] for name in affected) and sum(points.values()) > most:
                best, most = Mirroring(cameras, flip), float(sum(points.values()))
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
