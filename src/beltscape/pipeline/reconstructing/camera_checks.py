"""Checks of the cameras while frames are matched: whether they still are where the rig says.

The schedule decides which frames are checked: periodically, and at once when a frame is unusual. A frame is checked
by itself, together with those before, and against the first ones. Findings state the result, and faults hold until
a check passes; the error that all pixels have in common is added to σ. The rig in which a moved camera stands where
it was found is a proposal for a person to accept, never used by itself.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import OutputError
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.rig_json import write_rig
from beltscape.health.camera_poses import (
    PoseFault,
    count_unchecked,
    make_pose_findings,
    make_unchecked_finding,
    make_unreliable_finding,
    repeat_faults,
)
from beltscape.health.redundancy import make_redundancy_finding
from beltscape.pipeline.reconstructing.frame_measurements import (
    CameraRequest,
    CamerasAhead,
    DepthSummary,
    summarise_depth,
)
from beltscape.stereo.consistency.check import (
    POOLED_FRAMES,
    ResidualAccumulator,
    assess_tie_points,
    check_consistency,
)
from beltscape.stereo.consistency.diagnosis import (
    CameraFault,
    FaultCauses,
    add_instant,
    find_causes,
    list_faults,
)
from beltscape.stereo.consistency.pose_change import PoseChange
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.consistency.tie_points import TiePoints, join_tie_points
from beltscape.stereo.consistency.tolerance import Tolerance, compute_tolerance
from beltscape.stereo.consistency.wrong_images import FittingPoints, OtherInstant, is_of_own_instant
from beltscape.workers.transport import SharedObject


class CameraCheck:
    """Checks the cameras of successive frames; tolerances and searches are computed once."""

    def __init__(self, rig: Rig, near_far_mm: tuple[float, float]) -> None:
        self._rig = rig
        self._depth_mm = 2 / (1 / near_far_mm[0] + 1 / near_far_mm[1])
        self._tolerance: Tolerance | None = None
        self._accumulator: ResidualAccumulator | None = None
        self._checks = 0
        """Number of frames that were added to it."""
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
        self._request: SharedObject[CameraRequest] | None = None
        """The last request."""

    def note_frame(self, frame_set: FrameSet) -> None:
        """Note the next frame set of the sequence, whether it will be checked or not."""
        self._previous, self._frame_set = self._frame_set, frame_set

    def _get_tolerance(self) -> Tolerance:
        if self._tolerance is None:
            self._tolerance = compute_tolerance(self._rig, self._depth_mm)
        return self._tolerance

    def make_request(self, auxiliaries: tuple[str, ...]) -> SharedObject[CameraRequest]:
        """Return what a check of a frame needs beside it, if no other check comes before."""
        request = None if self._request is None else self._request.value
        is_same = request is not None and request.holds_for(auxiliaries, self._confirmed)
        if self._request is None or request is None or not is_same or request.checks != self._checks:
            accumulator = pickle.dumps(self._get_accumulator())
            request = CameraRequest(
                auxiliaries, self._get_tolerance(), self._confirmed, accumulator, self._checks
            )
            self._request = SharedObject(request)
        return self._request

    def _get_accumulator(self) -> ResidualAccumulator:
        if self._accumulator is None:
            self._accumulator = ResidualAccumulator(self._rig, self._depth_mm)
        return self._accumulator

    def check(
        self,
        frame_set: FrameSet,
        depth: DepthMap | None,
        auxiliaries: tuple[str, ...],
        ahead: CamerasAhead | None = None,
    ) -> RigConsistency:
        """Return the consistency of one frame, together with those before it that left open which camera moved.

        What was measured ``ahead`` with this very depth is used as far as it holds.
        """
        tolerance = self._get_tolerance()
        if ahead is not None and ahead.request.holds_for(auxiliaries, self._confirmed):
            consistency = ahead.measured.consistency
        else:
            consistency = check_consistency(
                frame_set, self._rig, depth, auxiliaries, tolerance, self._confirmed
            )
        if consistency.is_confirmed:
            self._confirmed = consistency
        if not (consistency.suspects and consistency.guided):
            self._undecided.clear()
            return consistency
        return self._decide(frame_set.frame, consistency, auxiliaries, tolerance)

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

    def accumulate(self, consistency: RigConsistency, ahead: CamerasAhead | None = None) -> RigConsistency:
        """Return the contradiction that a sound frame shows together with those before it, or its own state."""
        if not consistency.guided:
            return consistency
        if ahead and ahead.measured.consistency is consistency and ahead.request.checks == self._checks:
            self._accumulator, together = ahead.measured.accumulator, ahead.measured.together
        else:
            accumulator = self._get_accumulator()
            accumulator.add(consistency.tie_points)
            together = accumulator.assess()
        self._checks += 1
        return together or consistency

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


_LONGEST_S = 10.0
"""Longest time between two checks, for slow sequences."""
_LEAST_FRAMES = 2
"""Unusual frames are checked at least this number of frames apart: a changing scene costs no check per frame."""
_MOST_REPEATED = 8
"""Number of checks in a row that are made of successive frames while it is not known which camera moved: four frames
together nearly always show it."""


class CheckSchedule:
    """Decides which frames of a sequence are checked; it depends on the frames only, not on the system's clock."""

    def __init__(self, every: int) -> None:
        """Every ``every``-th frame is checked at least."""
        self._every = every
        self._frames_since = every
        self._time_ns: int | None = None
        self.passed: DepthSummary | None = None
        """Of the last frame whose check passed; None before."""
        self._repeated = 0

    def is_due(self, frame_set: FrameSet, depth: DepthMap | None) -> bool:
        """Return whether a frame must be checked; ``depth`` is None if it could not be matched."""
        self._frames_since += 1
        if self._frames_since >= self._every or self._is_late(frame_set):
            return True
        return self._frames_since >= _LEAST_FRAMES and self._is_unusual(depth)

    def expects(self, frame_set: FrameSet, ahead: int) -> bool:
        """Return whether the frame after ``ahead`` others will probably be due; of several only the first."""
        frames = self._frames_since + ahead + 1
        return frames == self._every or (not ahead and (frames > self._every or self._is_late(frame_set)))

    def note_check(
        self, frame_set: FrameSet, depth: DepthMap | None, *, has_passed: bool, is_undecided: bool = False
    ) -> None:
        """Account for a check; an unusual frame that passed is the usual one from now on.

        After an undecided check the next frame is due, some times in a row.
        """
        self._frames_since, self._time_ns = 0, frame_set.time_ns
        self._repeated = self._repeated + 1 if is_undecided else 0
        if 0 < self._repeated <= _MOST_REPEATED:
            self.request()
        if has_passed and depth is not None:
            self.passed = summarise_depth(depth)

    def request(self) -> None:
        """Make the next frame due."""
        self._frames_since = self._every

    def _is_late(self, frame_set: FrameSet) -> bool:
        if frame_set.time_ns is None or self._time_ns is None:
            return False
        return frame_set.time_ns - self._time_ns >= _LONGEST_S * 1e9

    def _is_unusual(self, depth: DepthMap | None) -> bool:
        return depth is None or (self.passed is not None and self.passed.differs(summarise_depth(depth)))


_LONGEST_UNCONFIRMED = 10
"""Number of checks without a consistent auxiliary after which the cameras count as unchecked again."""


class CameraFindings:
    """Makes the findings of each frame from the last check."""

    def __init__(self, rig: Rig, auxiliaries: tuple[str, ...]) -> None:
        self.latest: tuple[Finding, ...] = ()
        """The findings of the last frame."""
        self._rig, self._auxiliaries = rig, auxiliaries
        self._consistency: RigConsistency | None = None
        self._checked: tuple[Finding, ...] = ()
        """The findings about poses of the last check."""
        self._unconfirmed = _LONGEST_UNCONFIRMED
        """Checks since the last that showed an auxiliary to be consistent."""

    def set_checked(
        self,
        consistency: RigConsistency,
        faults: Sequence[CameraFault],
        used: tuple[str, ...],
        systematic_mm: float,
        *,
        used_before: tuple[str, ...],
        is_suspect: bool,
    ) -> None:
        """Set the findings of a checked frame, measured with the ``used`` auxiliaries.

        ``systematic_mm`` is the error of its depth. The frames since the last check were measured with
        ``used_before``: in them an auxiliary that is now excluded had its share of the error.
        """
        share = {
            each.camera: each.depth_error_mm / len(self._auxiliaries)
            for each in consistency.cameras
            if each.camera in used_before
        }
        pose_faults = [
            PoseFault(
                fault,
                "degraded",
                float(np.nanmax([systematic_mm, *(share.get(name, 0.0) for name in fault.cameras)])),
            )
            for fault in faults
        ]
        self._consistency = consistency
        self._unconfirmed = 0 if consistency.find_auxiliaries("sound") else self._unconfirmed + 1
        self._checked = make_pose_findings(consistency, self._rig, pose_faults, is_suspect=is_suspect)
        self._complete(self._checked, used)

    def set_refused(self, consistency: RigConsistency, faults: Sequence[CameraFault]) -> None:
        """Set the findings of a frame whose depth is refused because of its cameras."""
        lost = [PoseFault(fault, "missing", 0.0) for fault in faults]
        self._checked = make_pose_findings(consistency, self._rig, lost)
        self.latest = self._checked

    def set_unreliable(self, cause: str) -> None:
        """Add that the last frame's depth is unreliable."""
        self.latest = (*self.latest, make_unreliable_finding(cause))

    def set_unmatched(self) -> None:
        """Set the findings of a frame without depth that was not checked."""
        self.latest = repeat_faults(self._checked)

    def set_unchecked(self, used: tuple[str, ...]) -> None:
        """Set the findings of a frame that was not checked."""
        self._complete(repeat_faults(self._checked), used)

    def _complete(self, poses: Sequence[Finding], used: tuple[str, ...]) -> None:
        """Add the redundancy; before the cameras were confirmed, no frame is valid."""
        is_open = self._unconfirmed >= _LONGEST_UNCONFIRMED and not any(each.is_fault for each in poses)
        make = make_unchecked_finding if is_open else count_unchecked
        self.latest = (
            *poses,
            make(self._unconfirmed, _LONGEST_UNCONFIRMED),
            make_redundancy_finding(self._auxiliaries, used, self._consistency),
        )


PROPOSAL_FILE = "rig.proposed.json"
_POSE_PARAMETERS = ("turn_x_rad", "turn_y_rad", "turn_z_rad", "shift_x_mm", "shift_y_mm", "shift_z_mm")
"""Parameters of a pose in rig.json's covariance."""
_MORE_PRECISE = 0.8
"""A later estimate replaces a proposal if its σ is below this share of the proposal's."""
_MOVED_AGAIN = 4.0
"""It also does if it differs by this number of its σ."""


def make_rig_writer(folder: Path, rig: Rig, reporter: Reporter) -> Callable[[Rig], None]:
    """Return a function that writes a proposed pose of the ``rig``'s cameras to the folder's rig.proposed.json.

    The intrinsics stay those of ``rig``, also if the proposal comes from images of another size.
    """

    def write(proposed: Rig) -> None:
        path = folder / PROPOSAL_FILE
        try:
            write_rig(
                path, replace(rig, cam_from_core=proposed.cam_from_core, covariance=proposed.covariance)
            )
        except OutputError as error:
            reporter.warn(f"{path}: the proposed rig could not be written: {error}")

    return write


class RigProposals:
    """Passes on the best estimate of a moved camera's pose."""

    def __init__(self, rig: Rig, propose: Callable[[Rig], None] | None) -> None:
        self._rig, self._propose = rig, propose
        self._last: PoseChange | None = None

    def add(self, consistency: RigConsistency) -> None:
        """Propose the rig of a frame's pose change if it is new or more precise than the proposal before."""
        change = consistency.pose_change
        if change is None or self._propose is None or not (change.is_plausible and self._is_better(change)):
            return
        self._last = change
        self._propose(make_proposed_rig(self._rig, change))

    def _is_better(self, change: PoseChange) -> bool:
        last = self._last
        if last is None or last.camera != change.camera:
            return True
        sigma = np.sqrt(np.diag(change.covariance) + np.diag(last.covariance))
        has_moved = bool((np.abs(change.change - last.change) > _MOVED_AGAIN * sigma).any())
        return has_moved or change.shift_sigma_mm < _MORE_PRECISE * last.shift_sigma_mm


def explains_by_movement(consistency: RigConsistency) -> bool:
    """Return whether a plausible movement of one camera explains what contradicts the rig."""
    return consistency.pose_change is not None and consistency.pose_change.is_plausible


def make_proposed_rig(rig: Rig, change: PoseChange) -> Rig:
    """Return the rig after the movement, with the covariance of the moved pose.

    A movement of the core is one of all auxiliaries against it; their covariances stay those of the rig.
    """
    names = [f"{change.camera}.{parameter}" for parameter in _POSE_PARAMETERS]
    known = [str(name) for name in rig.covariance.get("parameters", [])]
    if change.camera == rig.core:
        return replace(rig, cam_from_core=change.rig.cam_from_core)
    parameters = [*(name for name in known if name not in names), *names]
    matrix = np.zeros((len(parameters), len(parameters)))
    kept = [known.index(name) for name in parameters if name in known and name not in names]
    if kept:
        matrix[: len(kept), : len(kept)] = np.asarray(rig.covariance["matrix"], np.float64)[
            np.ix_(kept, kept)
        ]
    matrix[len(kept) :, len(kept) :] = change.covariance
    covariance = {**rig.covariance, "parameters": parameters, "matrix": matrix.tolist()}
    return replace(rig, cam_from_core=change.rig.cam_from_core, covariance=covariance)


def compute_depth_error_per_px(rig: Rig, depth: DepthMap) -> float:
    """Return the depth error (mm) of a pixel of disparity at the map's median depth, over the mean baseline."""
    baseline = float(np.mean([np.linalg.norm(rig.cam_from_core[n].center_mm) for n in rig.auxiliaries]))
    middle = float(np.nanmedian(depth.depth_mm))
    return middle**2 / (float(rig.core_camera.focal_px.mean()) * baseline)


def add_systematic_error(depth: DepthMap, systematic_mm: float) -> DepthMap:
    """Return the map with an error common to all pixels added to its σ."""
    sigma = np.hypot(depth.sigma_mm, np.float32(systematic_mm)).astype(np.float32)
    return replace(depth, sigma_mm=sigma, systematic_mm=systematic_mm)


def select_consistent(consistency: RigConsistency) -> tuple[str, ...]:
    """Return the auxiliaries to measure with; none if the frame is ambiguous."""
    if consistency.core_moved or consistency.ambiguous or not consistency.find_auxiliaries("sound"):
        return ()
    return tuple(each.camera for each in consistency.cameras if each.camera not in consistency.inconsistent)
