"""The check of a sequence's cameras: each frame by itself, together with those before, and against the first ones."""

from __future__ import annotations

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.accumulation import POOLED_FRAMES, ResidualAccumulator
from beltscape.stereo.consistency.check import assess_tie_points, check_consistency
from beltscape.stereo.consistency.diagnosis.diagnosis import add_instant, find_causes
from beltscape.stereo.consistency.diagnosis.fault_texts import CameraFault, FaultCauses, list_faults
from beltscape.stereo.consistency.diagnosis.fitting_points import FittingPoints
from beltscape.stereo.consistency.diagnosis.instants import OtherInstant, is_of_own_instant
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
        self._causes: dict[tuple[str, ...], FaultCauses] = {}
        """What was found for a set of inconsistent cameras, since the last sound frame."""
        self._confirmed: RigConsistency | None = None
        """The last sound frame in which the points were also searched without the depth map."""
        self._frame_set: FrameSet | None = None
        self._previous: FrameSet | None = None
        """The frame set before the last one."""
        self._instant: OtherInstant | None = None
        """A camera of another instant, until a frame shows that it no longer is."""

    def note_frame(self, frame_set: FrameSet) -> None:
        """Note the next frame set of the sequence, whether it will be checked or not."""
        self._previous, self._frame_set = self._frame_set, frame_set

    def check(
        self, frame_set: FrameSet, depth: DepthMap | None, auxiliaries: tuple[str, ...]
    ) -> RigConsistency:
        """Return the consistency of one frame, together with those before it that left open which camera moved."""
        if self._tolerance is None:
            self._tolerance = compute_tolerance(self._rig, self._depth_mm)
        consistency = check_consistency(
            frame_set, self._rig, depth, auxiliaries, self._tolerance, self._confirmed
        )
        if consistency.is_confirmed:
            self._confirmed = consistency
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
        """Return the faults that explain the inconsistencies; what a set of cameras has is searched once."""
        causes = FaultCauses()
        if consistency.is_sound and consistency.find_auxiliaries("sound", "undecided"):
            self._causes.clear()
        else:
            key = consistency.inconsistent
            if key not in self._causes:
                self._causes[key] = find_causes(frame_set, self._rig, consistency)
            causes = self._causes[key]
        causes = add_instant(causes, frame_set, self._rig, consistency, self._previous)
        faults = list_faults(consistency, self._rig, causes)
        return self._hold_instant(frame_set, causes.instant, faults)

    def _hold_instant(
        self, frame_set: FrameSet, found: OtherInstant | None, faults: list[CameraFault]
    ) -> list[CameraFault]:
        """Return the faults with that of a camera that was late or early, until a frame shows its own instant.

        On a bare belt every instant shows the same; the depth of such a frame is right.
        """
        self._instant = found or self._instant
        if self._instant is None or found is not None or faults:
            return faults
        fitting = FittingPoints(frame_set, self._rig)
        if self._previous is None or is_of_own_instant(fitting, self._instant, self._previous):
            self._instant = None
            return faults
        return [CameraFault((self._instant.camera,), self._instant.describe(), is_of_instant=True)]
