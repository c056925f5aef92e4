"""The check of a sequence's cameras: each frame by itself, together with those before, and against the first ones."""

from __future__ import annotations

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.accumulation import POOLED_FRAMES, ResidualAccumulator
from beltscape.stereo.consistency.check import assess_tie_points, check_consistency
from beltscape.stereo.consistency.diagnosis.diagnosis import MisplacedImages, find_misplaced_images
from beltscape.stereo.consistency.diagnosis.fault_texts import CameraFault, list_faults
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.consistency.tie_points.tie_points import TiePoints, join_tie_points
from beltscape.stereo.consistency.tolerance import Tolerance, compute_tolerance


class CameraCheck:
    """Checks the cameras of successive frames; tolerances and searches are computed once."""

    def __init__(self, rig: Rig, near_far_mm: tuple[float, float]) -> None:
        self._rig = rig
        self._depth_mm = 2 / (1 / near_far_mm[0] + 1 / near_far_mm[1])
        self._tolerance: Tolerance | None = None
        self._accumulator: ResidualAccumulator | None = None
        self._undecided: dict[str, TiePoints] = {}
        """By frame: the tie points of the last frames that do not show which camera moved."""
        self._misplaced: dict[tuple[str, ...], MisplacedImages] = {}
        """What was found for a set of inconsistent cameras, since the last sound frame."""

    def check(
        self, frame_set: FrameSet, depth: DepthMap | None, auxiliaries: tuple[str, ...]
    ) -> RigConsistency:
        """Return the consistency of one frame, together with those before it that left open which camera moved."""
        if self._tolerance is None:
            self._tolerance = compute_tolerance(self._rig, self._depth_mm)
        consistency = check_consistency(frame_set, self._rig, depth, auxiliaries, self._tolerance)
        if not (consistency.suspects and consistency.guided):
            self._undecided.clear()
            return consistency
        return self._decide(frame_set.frame, consistency, auxiliaries, self._tolerance)

    def _decide(
        self, frame: str, consistency: RigConsistency, auxiliaries: tuple[str, ...], tolerance: Tolerance
    ) -> RigConsistency:
        """Return what an undecided frame and the undecided ones before it show together, or its own consistency."""
        self._undecided.pop(frame, None)
        self._undecided[frame] = consistency.tie_points
        if len(self._undecided) > POOLED_FRAMES:
            del self._undecided[next(iter(self._undecided))]
        together = assess_tie_points(
            join_tie_points(list(self._undecided.values())), self._rig, auxiliaries, tolerance
        )
        return consistency if together.is_sound or together.suspects else together

    def accumulate(self, consistency: RigConsistency) -> RigConsistency:
        """Return the contradiction that a sound frame shows together with those before it, or its own state."""
        if not consistency.guided:
            return consistency
        if self._accumulator is None:
            self._accumulator = ResidualAccumulator(self._rig, self._depth_mm)
        self._accumulator.add(consistency.tie_points)
        return self._accumulator.assess() or consistency

    def is_suspect(self, consistency: RigConsistency) -> bool:
        """Return whether a sound frame by itself leaves open that cameras have moved since the first frames."""
        if self._accumulator is None or not (consistency.is_sound and consistency.guided):
            return False
        return self._accumulator.is_suspect(consistency.tie_points)

    def diagnose(self, frame_set: FrameSet, consistency: RigConsistency) -> list[CameraFault]:
        """Return the faults that explain the inconsistencies; exchanged images are searched once."""
        if consistency.is_sound and consistency.find_auxiliaries("sound"):
            self._misplaced.clear()
            return []
        key = consistency.inconsistent
        if key not in self._misplaced:
            self._misplaced[key] = find_misplaced_images(frame_set, self._rig, consistency)
        return list_faults(consistency, self._rig, self._misplaced[key])
