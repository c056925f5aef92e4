"""Two cameras whose images were exchanged: the frame fits the rig when they change places."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.core.rig import Rig
from beltscape.stereo.consistency.check import RigConsistency
from beltscape.stereo.consistency.isolation import residuals_of
from beltscape.stereo.consistency.tie_points import Array, textured_points
from beltscape.stereo.consistency.unguided import unguided_points
from beltscape.stereo.multiview.initialisation.depth_range import search_range

_FITS_PX = 1.0
"""Systematic residual of a camera that fits, px of the small images."""
_POINTS = 150
"""Enough to tell a camera that fits from one that does not."""
_CLEARLY = 1.3
"""Points that fit, over those that fit as the images are now."""
_KNOCK = 2.0, 20.0
"""A knock turns a camera by less (°) and shifts it by less (mm): a greater movement that explains a frame is found by
chance among images of other cameras."""


def exchange_in_doubt(frame_set: FrameSet, rig: Rig, consistency: RigConsistency) -> tuple[str, str] | None:
    """Return the two cameras exchanged, where cameras are in doubt and the knock of one does not explain it."""
    doubtful, motion = consistency.doubtful, consistency.motion
    if len(consistency.cameras) < 2 or not doubtful:
        return None
    if motion is None and len(doubtful) < 2 and consistency.named("sound"):
        return None
    if motion is not None and motion.angle_deg < _KNOCK[0] and motion.shift_mm < _KNOCK[1]:
        return None
    enough = len(doubtful) > 1 and consistency.named("sound")
    names = tuple(name for name in rig.auxiliaries if name in frame_set.images)
    return exchange_of_frame(frame_set, rig, doubtful if enough else names)


def exchange_of_frame(frame_set: FrameSet, rig: Rig, doubtful: tuple[str, ...]) -> tuple[str, str] | None:
    """Return the two cameras whose exchange makes a frame's images fit; the core is tried where all are in doubt."""
    names = tuple(name for name in rig.auxiliaries if name in frame_set.images)
    points = textured_points(frame_set.images[rig.core], rig.core_camera, most=_POINTS)
    return exchanged_cameras(frame_set, rig, names, points, doubtful)


def exchanged_cameras(
    frame_set: FrameSet, rig: Rig, names: tuple[str, ...], points_px: Array, doubtful: tuple[str, ...]
) -> tuple[str, str] | None:
    """Return the two cameras whose exchange makes the images fit the rig; None where none does."""
    now = _fits(frame_set, rig, names, points_px)
    best: tuple[str, str] | None = None
    most = _CLEARLY * sum(now.values()) + 1
    with_core = len(doubtful) == len(names)
    for pair in combinations((rig.core, *doubtful) if with_core else doubtful, 2):
        images = dict(frame_set.images)
        images[pair[0]], images[pair[1]] = images[pair[1]], images[pair[0]]
        if any(images[n].shape[1::-1] != tuple(rig.cameras[n].size_px) for n in pair):
            continue
        own = (
            textured_points(images[rig.core], rig.core_camera, most=_POINTS)
            if rig.core in pair
            else points_px
        )
        own_names = names if rig.core in pair else pair
        fits = {**now, **_fits(replace(frame_set, images=images), rig, own_names, own)}
        total = sum(fits.values())
        both = all(fits[name] for name in own_names)
        if both and total >= most:
            best, most = pair, total
    return best


def _fits(frame_set: FrameSet, rig: Rig, names: tuple[str, ...], points_px: Array) -> dict[str, int]:
    """By auxiliary: how many points it shows on their epipolar lines; 0 where it does not fit."""
    tie = unguided_points(frame_set, rig, names, search_range(rig, names), points_px)
    across = residuals_of(tie, rig, names).across
    return {
        name: trend.points
        if np.isfinite(trend.rms_px) and trend.concentration > 0.6 and trend.rms_px < _FITS_PX * tie.pixel
        else 0
        for name, trend in across.items()
    }
