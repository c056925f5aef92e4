"""Search for two cameras whose images were exchanged: the frame fits the rig when they are exchanged back."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.fault_isolation import compute_frame_residuals
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.consistency.tie_points.tie_points import Array, detect_textured_points
from beltscape.stereo.consistency.tie_points.unguided_matching import match_unguided
from beltscape.stereo.multiview.initialisation.depth_range import compute_search_range

_FITS_PX = 1.0
"""Greatest systematic residual of a camera that fits, px of the small images."""
_LEAST_INLIERS = 0.6
"""Least share of inliers of a camera that fits."""
POINTS = 150
"""Number of points that distinguishes a camera that fits from one that does not."""
_GAIN = 1.3
"""Least ratio of the points that fit after the exchange to those that fit before."""


def find_exchange(frame_set: FrameSet, rig: Rig, consistency: RigConsistency) -> tuple[str, str] | None:
    """Return the two exchanged cameras; None if none is inconsistent or a knock of one camera explains the frame."""
    inconsistent, pose_change = consistency.inconsistent, consistency.pose_change
    has_sound = bool(consistency.find_auxiliaries("sound"))
    if len(consistency.cameras) < 2 or not inconsistent:
        return None
    if pose_change is None and len(inconsistent) < 2 and has_sound:
        return None
    if pose_change is not None and pose_change.is_plausible:
        return None
    suspects = (
        inconsistent if len(inconsistent) > 1 and has_sound else list_imaged_auxiliaries(frame_set, rig)
    )
    return find_exchange_among(frame_set, rig, suspects)


def find_exchange_among(frame_set: FrameSet, rig: Rig, suspects: tuple[str, ...]) -> tuple[str, str] | None:
    """Return the two of the suspected cameras whose exchange makes the images fit the rig best, or None.

    The core is suspected as well if all auxiliaries are.
    """
    names = list_imaged_auxiliaries(frame_set, rig)
    points_px = detect_textured_points(frame_set.images[rig.core], rig.core_camera, max_points=POINTS)
    before = count_fitting_points(frame_set, rig, names, points_px)
    best: tuple[str, str] | None = None
    most = _GAIN * sum(before.values()) + 1
    cameras = (rig.core, *suspects) if len(suspects) == len(names) else suspects
    for pair in combinations(cameras, 2):
        images = dict(frame_set.images)
        images[pair[0]], images[pair[1]] = images[pair[1]], images[pair[0]]
        if any(images[n].shape[1::-1] != tuple(rig.cameras[n].size_px) for n in pair):
            continue
        affected, affected_px = pair, points_px
        if rig.core in pair:
            affected = names
            affected_px = detect_textured_points(images[rig.core], rig.core_camera, max_points=POINTS)
        after = count_fitting_points(replace(frame_set, images=images), rig, affected, affected_px)
        total = sum({**before, **after}.values())
        if all(after[name] for name in affected) and total >= most:
            best, most = pair, total
    return best


def list_imaged_auxiliaries(frame_set: FrameSet, rig: Rig) -> tuple[str, ...]:
    """Return the auxiliaries that have an image in the frame."""
    return tuple(name for name in rig.auxiliaries if name in frame_set.images)


def count_fitting_points(
    frame_set: FrameSet, rig: Rig, names: tuple[str, ...], points_px: Array
) -> dict[str, int]:
    """Return by auxiliary the number of points on their epipolar lines; 0 for one that does not fit."""
    tie_points = match_unguided(frame_set, rig, names, compute_search_range(rig, names), points_px)
    epipolar = compute_frame_residuals(tie_points, rig, names).epipolar
    return {
        name: residual.points
        if np.isfinite(residual.rms_px)
        and residual.inlier_share > _LEAST_INLIERS
        and residual.rms_px < _FITS_PX * tie_points.pixel_scale
        else 0
        for name, residual in epipolar.items()
    }
