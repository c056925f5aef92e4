"""Why frames contradict the pose between two cameras that most frames agree on: no common instant, or another pose.

A board that moves between two exposures is displaced differently in every frame, so that no pose between the
cameras fits these frames together. A camera that was moved, and a lens that differs at another distance (focus),
change all of them alike: one other pose fits them all. Their order and their distances then tell the two apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.calibration.network.pairs import calibrate_pair
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.files.frame_names import natural_key

MAX_REST = 0.2
"""Largest share of the frames' excess over their cameras' own RMS that another pose may leave to explain them.

Simulated, 2 to 8 of 24 frames: 0.00 to 0.07 where a camera was moved or the lens was another one at half the
distance, 0.39 to 0.95 where the board moved between the exposures (36 captures); 0.13 on photographs."""

Run = Literal["", "first", "last"]


@dataclass(frozen=True, slots=True)
class SecondPose:
    """A second pose between two cameras, which frames that contradict the others agree on."""

    within_px: float
    """RMS of these frames with it."""
    run: Run
    """Whether they are the first or the last frames of the pair; empty: neither."""
    edge: str
    """The last frame before the change, or the first one after it; empty without a run."""
    distances_mm: tuple[float, float]
    """The nearest and the farthest of their boards."""
    others_mm: tuple[float, float]
    """Those of the other frames."""

    @property
    def is_by_distance(self) -> bool:
        """Whether all these boards are nearer, or all farther, than all others."""
        return self.distances_mm[1] < self.others_mm[0] or self.distances_mm[0] > self.others_mm[1]

    @property
    def kind(self) -> tuple[Run, bool]:
        """Return what tells causes apart: the run, and whether the frames differ by their distance."""
        return self.run, self.is_by_distance

    def describe(self, cameras: str) -> str:
        """Return the likely cause and the fix, as the end of a line that names the frames and their misfit."""
        agree = f"but within {self.within_px:.2g} px with another pose between the cameras"
        moved = self._describe_move()
        if not self.is_by_distance:
            return f"{agree}: {moved}"
        lens = (
            f"{cameras} see the board at {_format_range(self.distances_mm)} there, at "
            f"{_format_range(self.others_mm)} in all other frames, and the lenses that fit those do not hold at that "
            "distance (focus)"
        )
        if self.run:
            return f"{agree}: {lens}, or {moved}"
        return f"{agree}: {lens}. They are left out, and the rig holds at the distance of the others"

    def _describe_move(self) -> str:
        if self.run == "last":
            return (
                f"a camera was moved or its focus touched after frame {self.edge}. They are left out, so that the "
                f"rig is that up to {self.edge}: if nothing was put back, it does not hold now, and the cameras must "
                "be calibrated from frames taken since"
            )
        if self.run == "first":
            return (
                f"a camera was moved or its focus touched before frame {self.edge}. They are left out, and the rig "
                f"is that from {self.edge} on"
            )
        return (
            "a camera is loose or its focus was touched, or the board always moved alike while it was triggered "
            "late. They are left out: check mounts, focus and trigger"
        )


def find_second_pose(
    detections: BoardDetections,
    cameras: tuple[MonocularCalibration, MonocularCalibration],
    excess_px: float,
    bad: Mapping[str, float],
    frames: Sequence[str],
    board_mm: Array,
) -> SecondPose | None:
    """Return the other pose that fits the ``bad`` frames of a pair; None if none does.

    ``bad`` has the RMS of each frame by its two cameras alone, ``excess_px`` is the root of the mean of what the
    squared RMS with the pose of the other ``frames`` exceeds its square.
    """
    first, second = (camera.select(list(bad)) for camera in cameras)
    try:
        pair = calibrate_pair(
            detections.restrict([c.camera.name for c in cameras], bad), first, second, board_mm
        )
    except (CalibrationError, np.linalg.LinAlgError):
        return None
    if pair is None or pair.rejected:
        return None
    alone_px = np.sqrt(np.mean(np.square(list(bad.values()))))
    if np.sqrt(max(pair.rms_px**2 - alone_px**2, 0.0)) > MAX_REST * excess_px:
        return None
    ordered = sorted(frames, key=natural_key)
    run, edge = _find_run(ordered, bad)
    views = detections.views[cameras[0].camera.name]
    depths = {
        frame: float(np.mean(cameras[0].cam_from_board[frame].apply(board_mm[views[frame].ids])[:, 2]))
        for frame in ordered
    }
    near, far = ([depths[f] for f in ordered if (f in bad) is flag] for flag in (True, False))
    return SecondPose(pair.rms_px, run, edge, (min(near), max(near)), (min(far), max(far)))


def _find_run(ordered: Sequence[str], bad: Mapping[str, float]) -> tuple[Run, str]:
    """Return whether the bad frames are the first or the last ones, and the frame next to them."""
    count = len(bad)
    if set(ordered[-count:]) == set(bad):
        return "last", ordered[-count - 1]
    if set(ordered[:count]) == set(bad):
        return "first", ordered[count]
    return "", ""


def _format_range(distances_mm: tuple[float, float]) -> str:
    return f"{distances_mm[0]:.0f} to {distances_mm[1]:.0f} mm"
