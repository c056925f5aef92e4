"""Search for two cameras whose images were exchanged: the frame fits the rig when they are exchanged back."""

from __future__ import annotations

from itertools import combinations

from beltscape.stereo.consistency.diagnosis.fitting_points import FittingPoints
from beltscape.stereo.consistency.rig_consistency import RigConsistency

_GAIN = 1.3
"""Least ratio of the points that fit after the exchange to those that fit before."""


def find_exchange(fitting: FittingPoints, consistency: RigConsistency) -> tuple[str, str] | None:
    """Return the two exchanged cameras; None if none is inconsistent or a knock of one camera explains the frame."""
    inconsistent, pose_change = consistency.inconsistent, consistency.pose_change
    has_sound = bool(consistency.find_auxiliaries("sound"))
    if len(consistency.cameras) < 2 or not inconsistent:
        return None
    if pose_change is None and len(inconsistent) < 2 and has_sound:
        return None
    if pose_change is not None and pose_change.is_plausible:
        return None
    suspects = inconsistent if len(inconsistent) > 1 and has_sound else fitting.auxiliaries
    return find_exchange_among(fitting, suspects)


def find_exchange_among(fitting: FittingPoints, suspects: tuple[str, ...]) -> tuple[str, str] | None:
    """Return the two of the suspected cameras whose exchange makes the images fit the rig best, or None.

    The core is suspected as well if all auxiliaries are.
    """
    rig, images = fitting.rig, fitting.frame_set.images
    best: tuple[str, str] | None = None
    most = _GAIN * sum(fitting.unchanged.values()) + 1
    cameras = (rig.core, *suspects) if len(suspects) == len(fitting.auxiliaries) else suspects
    for one, other in combinations(cameras, 2):
        exchanged = {one: images[other], other: images[one]}
        if any(image.shape[1::-1] != tuple(rig.cameras[name].size_px) for name, image in exchanged.items()):
            continue
        points = fitting.count_with(exchanged)
        affected = fitting.auxiliaries if rig.core in exchanged else (one, other)
        total = sum(points.values())
        if all(points[name] for name in affected) and total >= most:
            best, most = (one, other), total
    return best
