"""Search for a camera whose images are of another instant: they fit those of the others one frame before or after."""

from __future__ import annotations

from dataclasses import dataclass, replace

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.live.translatable_message import Message
from beltscape.stereo.consistency.diagnosis.fitting_points import FittingPoints
from beltscape.stereo.consistency.rig_consistency import RigConsistency

_GAIN = 1.3
"""Least ratio of the points that fit at another instant to those that fit at the frame's own."""
_LEAST_GAIN = 12
"""Least number of points that fit in addition; fewer agree by chance."""
_AMONG_GAIN = 1.6
"""Least ratio of the share of points in which auxiliaries agree with each other to that in which they do with the
core: 1.6 is chosen; on sound rendered rooms it is below 1, since two auxiliaries stand farther apart, and 2.2 to 2.5
with a core of another instant."""
_LEAST_AMONG = 0.25
"""Least share of points in which auxiliaries of one instant agree; heaps of stones have 0.12 to 0.3."""


@dataclass(frozen=True, slots=True)
class OtherInstant:
    """A camera whose images are of another instant than the others'."""

    camera: str
    frames: int
    """Frames by which its images are late; negative: early; 0: by an unknown time."""
    points: int
    """Number of points that agree at its instant, or among the others."""
    own_points: int
    """Number of points that agree at the frame's own instant, or of the others with it."""

    def describe(self) -> str:
        """Return the line that names the camera and the fix."""
        values = {"camera": self.camera, "points": self.points, "own": self.own_points}
        if not self.frames:
            text = (
                f"the other cameras agree with each other in {self.points} % of the points, but with {self.camera} "
                f"in {self.own_points} % only: its image is of another instant (synchronisation), or another "
                "scene's; check its trigger cable, frame numbers and clock"
            )
            return Message(text, "camera_sync_other", **values)
        side, key = (
            ("older", "camera_sync_frame_late") if self.frames > 0 else ("newer", "camera_sync_frame_early")
        )
        other = "before" if self.frames > 0 else "after"
        text = (
            f"{self.camera}: its images are one frame {side} than the other cameras': {self.points} points agree "
            f"with the others' frame {other}, {self.own_points} with their own; check its trigger cable, frame "
            "numbers and clock"
        )
        return Message(text, key, **values)


def find_other_instant(
    fitting: FittingPoints, consistency: RigConsistency, previous: FrameSet | None
) -> OtherInstant | None:
    """Return the camera whose images are of another instant; None if the frame does not show one.

    ``previous`` is the frame set before. A camera is late if its image fits the others' of that frame, and early if
    its image of that frame fits the others' of this one. Without it, only a core is found, with which no auxiliary
    agrees although they agree with each other.
    """
    doubted = consistency.find_auxiliaries("contradicting", "unmatched", "undecided")
    core = fitting.rig.core
    all_doubted = len(doubted) == len(consistency.cameras)
    if previous is not None:
        suspects = ((core,) if all_doubted else ()) + (
            doubted if not all_doubted or len(doubted) == 1 else ()
        )
        for camera in suspects:
            found = _compare_frames(fitting, camera, previous)
            if found is not None:
                return found
    return _compare_among_auxiliaries(fitting) if all_doubted and len(doubted) > 1 else None


def is_of_own_instant(fitting: FittingPoints, before: OtherInstant, previous: FrameSet) -> bool:
    """Return whether a frame shows that a camera's images are no longer of another instant.

    Where nothing moves, it shows neither.
    """
    own, other = _count_pair(fitting, before.camera, previous, before.frames)
    return own >= _GAIN * other + _LEAST_GAIN


def _compare_frames(fitting: FittingPoints, camera: str, previous: FrameSet) -> OtherInstant | None:
    """Return by how many frames a camera is late or early; None if its image fits its own frame as well."""
    best: OtherInstant | None = None
    for frames in (1, -1):
        own, other = _count_pair(fitting, camera, previous, frames)
        if other >= max(_GAIN * own, own + _LEAST_GAIN) and (best is None or other > best.points):
            best = OtherInstant(camera, frames, other, own)
    return best


def _count_pair(fitting: FittingPoints, camera: str, previous: FrameSet, frames: int) -> tuple[int, int]:
    """Return the points of a camera that fit the others' images of its own frame, and with it late by ``frames``."""
    rig, images = fitting.rig, fitting.frame_set.images
    names = fitting.auxiliaries if camera == rig.core else (camera,)
    names = tuple(name for name in names if name in previous.images)
    if rig.core not in previous.images or not names:
        return 0, 0
    cameras = (rig.core, *names)
    is_old = {name: (name == camera) != (frames > 0) for name in cameras}
    mixed = {name: (previous if is_old[name] else fitting.frame_set).images[name] for name in cameras}
    if any(mixed[name].shape != images[name].shape for name in cameras):
        return 0, 0
    other = fitting.count(replace(fitting.frame_set, images=mixed), names)
    return sum(fitting.unchanged[name] for name in names), sum(other.values())


def _compare_among_auxiliaries(fitting: FittingPoints) -> OtherInstant | None:
    """Return the core if the auxiliaries agree with each other in many more points than with it."""
    rig, names = fitting.rig, fitting.auxiliaries
    with_core = fitting.measure_agreement(fitting.frame_set, names)
    others = FittingPoints(fitting.frame_set, _leave_core_out(rig, names))
    among = others.measure_agreement(fitting.frame_set, names[1:])
    if among < _AMONG_GAIN * with_core or among < _LEAST_AMONG:
        return None
    return OtherInstant(rig.core, 0, round(100 * among), round(100 * with_core))


def _leave_core_out(rig: Rig, names: tuple[str, ...]) -> Rig:
    """Return the rig of the auxiliaries alone, about the first of them."""
    poses = {name: rig.relative_pose(name, names[0]) for name in names}
    return Rig(names[0], {name: rig.cameras[name] for name in names}, poses)
