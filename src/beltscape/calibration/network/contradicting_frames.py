"""Frames that contradict the pose between two cameras, though each camera fits them by itself.

Two rigidly mounted cameras have one relative pose. The pose that most frames agree on is found first, from the frames
one by one, so that a third of bad ones does not shift it; the frames that it does not fit are left out by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.calibration.network.frame_causes import SecondPose, find_second_pose
from beltscape.calibration.network.pairs import Pair, calibrate_pair
from beltscape.calibration.network.resection import fit_board_pose
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig

MIN_EXCESS, MIN_EXCESS_PX = 2.0, 0.1
"""A pair is looked into if its RMS exceeds that of its cameras alone by this factor, and exceeds this many px."""
BAD_FACTOR, BAD_PX = 3.0, 0.1
"""A frame contradicts the others if its RMS exceeds that of the better half by this factor, and by this many px."""
MAX_EXCESS_PX = 1e4
"""Misfit that counts for a frame that no pose fits, for another pose to be compared with: larger than an image."""
CANDIDATES = 12
"""Frames whose relative pose is tried: of a dozen at least one is good unless most frames are bad."""
MIN_FRAMES = 2
"""Least number of bad frames of a pair for a finding; a single one is left out like any view that does not fit."""
MAX_BAD = 0.45
"""Largest share of bad frames, of a pair and of all: if nearly half of them disagree, no pose is that of most, and a
missing trigger is reported as such."""


@dataclass(frozen=True, slots=True)
class ContradictingFrame:
    """A frame that contradicts the pose between cameras that the other frames agree on."""

    frame: str
    cameras: tuple[str, ...]
    """Cameras whose view of the frame is left out."""
    together_px: float
    """RMS of the worst pair with the relative pose of the other frames."""
    alone_px: float
    """RMS of the two cameras, each with a pose of the board of its own."""
    corners: int
    """Corners of the views that are left out."""
    change: SecondPose | None = None
    """The other pose of the worst pair that such frames agree on; None: they have no common instant."""


@dataclass(frozen=True, slots=True)
class _Misfit:
    """Misfit of a frame with the pose of most frames of a pair."""

    together_px: float
    alone_px: float
    change: SecondPose | None


def find_contradicting_frames(
    detections: BoardDetections,
    monocular: Mapping[str, MonocularCalibration],
    pairs: Sequence[Pair],
    board_mm: Array,
) -> tuple[ContradictingFrame, ...]:
    """Return the frames that contradict the others, of pairs that fit worse than their cameras or reject frames.

    A camera that no other agrees with in a frame is left out of it; of two without a third one, both are.
    """
    bad: dict[str, dict[tuple[str, str], _Misfit]] = {}
    for pair in pairs:
        alone = max(monocular[pair.first].rms_px, monocular[pair.second].rms_px)
        if pair.rms_px > max(MIN_EXCESS * alone, MIN_EXCESS_PX) or len(pair.rejected) >= MIN_FRAMES:
            for frame, sizes in _find_bad_frames(detections, monocular, pair, board_mm).items():
                bad.setdefault(frame, {})[pair.first, pair.second] = sizes
    if len(bad) > MAX_BAD * len(detections.frames):
        return ()
    order = {frame: number for number, frame in enumerate(detections.frames)}
    return tuple(_assign_frame(frame, bad[frame], detections) for frame in sorted(bad, key=order.__getitem__))


def _assign_frame(
    frame: str, disagreeing: Mapping[tuple[str, str], _Misfit], detections: BoardDetections
) -> ContradictingFrame:
    """Return the cameras to leave out of a frame, those of most disagreements first, until none is left."""
    worst = max(disagreeing.values(), key=lambda misfit: misfit.together_px)
    open_pairs, out = list(disagreeing), list[str]()
    while open_pairs:
        counts = {name: sum(name in pair for pair in open_pairs) for pair in open_pairs for name in pair}
        most = [name for name, count in counts.items() if count == max(counts.values())]
        out += most
        open_pairs = [pair for pair in open_pairs if not set(pair) & set(most)]
    corners = sum(len(detections.views[name][frame]) for name in out)
    return ContradictingFrame(frame, tuple(out), worst.together_px, worst.alone_px, corners, worst.change)


def _find_bad_frames(
    detections: BoardDetections, monocular: Mapping[str, MonocularCalibration], pair: Pair, board_mm: Array
) -> dict[str, _Misfit]:
    """Return the frames that the pose of most frames does not fit."""
    cameras = monocular[pair.first], monocular[pair.second]
    frames = [*pair.frames, *pair.rejected]
    relative = {f: cameras[1].cam_from_board[f] @ cameras[0].cam_from_board[f].inverse() for f in frames}
    errors = {
        frame: _measure_frames(detections, cameras, relative[frame], frames, board_mm)
        for frame in frames[:: max(len(frames) // CANDIDATES, 1)]
    }
    best = min(errors, key=lambda frame: float(np.median(list(errors[frame].values()))))
    good = _select_good(errors[best])
    kept = detections.restrict([pair.first, pair.second], good)
    first, second = (camera.select(good) for camera in cameras)
    refined = calibrate_pair(kept, first, second, board_mm)
    if refined is None:
        return {}
    final = _measure_frames(detections, cameras, refined.second_from_first, frames, board_mm)
    good = _select_good(final)
    if len(frames) - len(good) > MAX_BAD * len(frames):
        return {}
    alone = {f: max(camera.view_rms_px[f] for camera in cameras) for f in frames}
    bad = [f for f in frames if f not in good and final[f] > MIN_EXCESS * alone[f]]
    if len(bad) < MIN_FRAMES:
        return {}
    excess = np.array([min(final[f], MAX_EXCESS_PX) ** 2 - alone[f] ** 2 for f in bad])
    change = find_second_pose(
        detections, cameras, float(np.sqrt(excess.mean())), {f: alone[f] for f in bad}, frames, board_mm
    )
    return {f: _Misfit(final[f], alone[f], change) for f in bad}


def _select_good(errors_px: Mapping[str, float]) -> list[str]:
    """Return the frames that fit like the better half."""
    half = float(np.median(np.sort(list(errors_px.values()))[: (len(errors_px) + 1) // 2]))
    limit = max(BAD_FACTOR * half, half + BAD_PX)
    return [frame for frame, error in errors_px.items() if error <= limit]


def _measure_frames(
    detections: BoardDetections,
    cameras: tuple[MonocularCalibration, MonocularCalibration],
    second_from_first: Pose,
    frames: Sequence[str],
    board_mm: Array,
) -> dict[str, float]:
    """Return the RMS of each frame, px, with one pose of the board for both cameras; infinite where none fits."""
    first, second = (each.camera for each in cameras)
    poses = {first.name: Pose.identity(), second.name: second_from_first}
    rig = Rig(first.name, {first.name: first, second.name: second}, poses)
    found: dict[str, float] = {}
    for frame in frames:
        views = {name: detections.views[name][frame] for name in rig.cameras}
        try:
            found[frame] = _compute_rms(rig, views, fit_board_pose(rig, views, board_mm), board_mm)
        except (CalibrationError, np.linalg.LinAlgError):
            found[frame] = float("inf")
    return found


def _compute_rms(rig: Rig, views: Mapping[str, Corners], pose: Pose, board_mm: Array) -> float:
    errors: list[Array] = []
    for name, corners in views.items():
        in_camera = (rig.cam_from_core[name] @ pose).apply(board_mm[corners.ids])
        errors.append(rig.cameras[name].project(in_camera) - corners.pixels)
    return float(np.sqrt(np.nanmean((np.concatenate(errors) ** 2).sum(axis=1))))


def leave_out_frames(
    detections: BoardDetections, contradicting: Sequence[ContradictingFrame]
) -> BoardDetections:
    """Return the detections without the views that contradict the others."""
    out = {(name, each.frame) for each in contradicting for name in each.cameras}
    views = {
        name: {frame: corners for frame, corners in own.items() if (name, frame) not in out}
        for name, own in detections.views.items()
    }
    return BoardDetections(detections.sizes_px, views, detections.images, detections.types)


def describe_contradicting_frames(contradicting: Sequence[ContradictingFrame]) -> list[str]:
    """Return a finding of each group of frames with one cause, with their names; empty without any."""
    groups: dict[object, list[ContradictingFrame]] = {}
    for each in contradicting:
        groups.setdefault((each.cameras, each.change and each.change.kind), []).append(each)
    return [_describe_group(own) for own in groups.values()]


def _describe_group(contradicting: Sequence[ContradictingFrame]) -> str:
    """Return the finding of frames from which the same cameras are left out for one cause."""
    worst = max(contradicting, key=lambda each: each.together_px)
    named, count = ", ".join(each.frame for each in contradicting), len(worst.cameras)
    names = f"camera{'s' * (count > 1)} {' and '.join(worst.cameras)}"
    alone = max(each.alone_px for each in contradicting)
    fit = (
        f"{names} {'fits by itself' if count == 1 else 'fit by themselves'} within {alone:.2g} px there, "
        f"and together only within {worst.together_px:.2g} px"
    )
    if worst.change is None:
        return (
            f"frames {named} have no common instant: {fit}; they are left out: check the trigger, or hold the board "
            "still in each frame"
        )
    return (
        f"frames {named} contradict the others in one and the same way: {fit}, {worst.change.describe(names)}"
    )
