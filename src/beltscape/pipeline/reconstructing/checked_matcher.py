"""The matcher of frame after frame with a check of the cameras.

Inconsistent cameras are excluded, or σ of the depth is raised. Threads or workers may match frames beside the process
that checks them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.pipeline.reconstructing.camera_checks import (
    CameraCheck,
    CameraFindings,
    CheckSchedule,
    RigProposals,
    add_systematic_error,
    compute_depth_error_per_px,
    explains_by_movement,
    select_consistent,
)
from beltscape.pipeline.reconstructing.frame_measurements import (
    CamerasAhead,
    MeasurementRequest,
)
from beltscape.pipeline.reconstructing.pending_match import FrameMatcher, MatchPool, PendingMatch
from beltscape.stereo.cameras import list_usable_auxiliaries
from beltscape.stereo.consistency.check import LEAST_COVERAGE
from beltscape.stereo.consistency.diagnosis import CameraFault, describe_undecided, diagnose_low_coverage
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.consistency.tie_points import TiePoints
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings


class SequenceMatcher(Protocol):
    """Reconstructs frame after frame; the depth depends on a frame's images and on the cameras in use."""

    @property
    def is_inconsistent(self) -> bool:
        """Return whether cameras contradict the rig; the belt in such frames counts as degraded."""
        ...

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return the findings about the cameras in the last frame, also if it could not be reconstructed."""
        ...

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        """Return the depth of a frame; ReconstructionError if its images do not suffice."""
        ...


GROSS_PX = 2.0
"""If no set of cameras is consistent and residuals exceed this, the depth map is refused as chance matches."""
_AVERAGING_AUXILIARIES = 4
"""The errors of this number of auxiliaries average out; with fewer, σ is raised (2 and a moved core: z 1.5)."""
CHECK_EVERY = 10
"""Number of frames of a moving belt per check; a check takes about a tenth of the time of the fastest preset."""


@dataclass(frozen=True, slots=True, eq=False)
class CheckedDepth:
    """Depth of a frame, and the consistency of its cameras."""

    depth: DepthMap
    consistency: RigConsistency | None
    """Result of the check; None: the frame was not checked."""
    auxiliaries: tuple[str, ...]
    """The auxiliaries used for the depth."""
    faults: tuple[str, ...]
    """One line per camera fault, or the likely cause of low coverage."""


class CheckedMatcher:
    """Reconstructs frames and checks the cameras' consistency in some of them."""

    def __init__(
        self,
        rig: Rig,
        auxiliaries: tuple[str, ...],
        depth_range_mm: tuple[float, float],
        make_matcher: Callable[[tuple[str, ...]], FrameMatcher],
        propose_rig: Callable[[Rig], None] | None = None,
        watch_points: Callable[[TiePoints], None] | None = None,
        *,
        every: int = 1,
    ) -> None:
        """``make_matcher`` returns the matcher for a set of auxiliaries; every ``every``-th frame is checked.

        ``propose_rig`` receives the rig with the estimated pose of a camera that moved; the matcher does not use it.
        ``watch_points`` receives the tie points of each checked frame that is sound, but for a movement of a camera.
        """
        self._watch_points = watch_points or (lambda _: None)
        self.rig = rig
        self.excluded: tuple[str, ...] = ()
        """Auxiliaries that were inconsistent in a frame and are no longer used."""
        self.is_inconsistent = False
        """Whether the last checked frame was inconsistent with the rig."""
        self._auxiliaries, self._near_far = auxiliaries, depth_range_mm
        self._make_matcher = make_matcher
        self._matchers: dict[tuple[str, ...], FrameMatcher] = {}
        self._schedule = CheckSchedule(every)
        self._cameras = CameraCheck(rig, depth_range_mm)
        self._findings = CameraFindings(rig, auxiliaries)
        self._proposals = RigProposals(rig, propose_rig)
        self._systematic_px = 0.0
        self._reported: tuple[tuple[str, ...], bool, bool] = (), False, False

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return the findings about the cameras in the last frame."""
        return self._findings.latest

    def reconstruct(
        self, frame_set: FrameSet, reporter: Reporter, *, pending: PendingMatch | None = None
    ) -> DepthMap:
        """Return the depth of a frame, which may be ``pending``; report its faults when they are new."""
        checked = self.measure(frame_set, reporter, pending=pending)
        if (consistency := checked.consistency) is not None:
            state = consistency.inconsistent, consistency.core_moved, bool(checked.faults)
            if state != self._reported:
                for line in checked.faults:
                    reporter.warn(line)
            self._reported = state
        return checked.depth

    def submit(
        self, frame_set: FrameSet, pool: MatchPool, request: MeasurementRequest | None = None
    ) -> PendingMatch | None:
        """Begin to match a frame in ``pool`` with the auxiliaries used at present; None if that cannot be begun.

        `measure` uses the result unless cameras were excluded since; its results are the same without it.
        """
        try:
            names = self._select_auxiliaries(frame_set)
            key = self._select_matcher(names, frame_set)
            if request is not None:
                request = self._request_check(frame_set, request)
            depth = pool.submit(frame_set, key, lambda: self._get_matcher(key), request)
            return PendingMatch(names, depth, request)
        except ReconstructionError:  # `measure` raises it when it is this frame's turn
            return None

    def _request_check(self, frame_set: FrameSet, request: MeasurementRequest) -> MeasurementRequest:
        """Return the request with a check of the cameras: where one will probably be due, or the depth is unusual."""
        is_expected = self._schedule.expects(frame_set, request.ahead)
        usual = None if is_expected else self._schedule.passed
        if not is_expected and usual is None:
            return request
        usable = list_usable_auxiliaries(self.rig, frame_set, self._auxiliaries)
        return replace(request, cameras=self._cameras.make_request(usable), usual=usual)

    def measure(
        self, frame_set: FrameSet, reporter: Reporter, *, pending: PendingMatch | None = None
    ) -> CheckedDepth:
        """Return the depth of a frame and the consistency of its cameras; `findings` are then those of this frame.

        ``pending`` is what `submit` returned for this frame.

        Raises
        ------
        ReconstructionError
            When its images do not suffice, or the cameras contradict each other grossly.
        """
        self._findings.set_unmatched()
        self._cameras.note_frame(frame_set)
        names = self._select_auxiliaries(frame_set)
        try:
            matched = None
            if pending is not None and pending.auxiliaries == names:
                matched = pending.wait()
            depth = self._match(names, frame_set, reporter) if matched is None else matched.depth
        except ReconstructionError:
            self._explain_failure(frame_set)
            raise
        if not self._schedule.is_due(frame_set, depth):
            self._findings.set_unchecked(names)
            return CheckedDepth(self._add_systematic(depth), None, names, ())
        before = names
        ahead = None if pending is None else pending.find_cameras(depth)
        names, depth, consistency = self._check_cameras(names, frame_set, depth, reporter, ahead)
        return self._assess(frame_set, depth, consistency, names, before)

    def _check_cameras(
        self,
        names: tuple[str, ...],
        frame_set: FrameSet,
        depth: DepthMap,
        reporter: Reporter,
        ahead: CamerasAhead | None,
    ) -> tuple[tuple[str, ...], DepthMap, RigConsistency]:
        """Return the consistent auxiliaries, the depth measured with them, and the cameras' consistency."""
        usable = list_usable_auxiliaries(self.rig, frame_set, self._auxiliaries)
        consistency = self._cameras.check(frame_set, depth, usable, ahead)
        for _ in usable:
            consistent = select_consistent(consistency)
            if consistency.is_sound or not consistent or consistent == names:
                break
            names = consistent
            depth = self._match(names, frame_set, reporter)
            consistency = self._cameras.check(frame_set, depth, usable)
        if consistency.guided and (consistency.is_sound or explains_by_movement(consistency)):
            self._watch_points(consistency.tie_points)
        if consistency.is_sound:
            consistency = self._cameras.accumulate(consistency, ahead)
            consistent = tuple(name for name in select_consistent(consistency) if name in usable)
            if consistent and consistent != names:
                names = consistent
                depth = self._match(names, frame_set, reporter)
        self.excluded = tuple(n for n in usable if n in consistency.inconsistent and n not in names)
        return names, depth, consistency

    def _assess(
        self,
        frame_set: FrameSet,
        depth: DepthMap,
        consistency: RigConsistency,
        names: tuple[str, ...],
        before: tuple[str, ...],
    ) -> CheckedDepth:
        """Return the depth, with raised σ if it was measured with inconsistent cameras.

        ``names`` are the auxiliaries it was measured with, ``before`` those of the frames since the last check.
        """
        self.is_inconsistent = not consistency.is_sound
        faults = self._cameras.diagnose(frame_set, consistency)
        uses_inconsistent = consistency.core_moved or not set(names).isdisjoint(consistency.inconsistent)
        # at low coverage or with gross residuals, an inconsistent camera's pixels match by chance
        is_gross = uses_inconsistent and consistency.misfit_px > GROSS_PX
        is_gross |= any(fault.concerns_core for fault in faults)
        # matches that contradict the rig outnumber those that the depth map guides to: it consists of chance matches
        is_gross |= uses_inconsistent and not consistency.guided
        is_open = bool(consistency.suspects or consistency.find_auxiliaries("undecided"))
        self._schedule.note_check(
            frame_set, depth, has_passed=consistency.is_sound and not is_open, is_undecided=is_open
        )
        if any(fault.is_of_instant for fault in faults):
            self._schedule.request()
        self._proposals.add(consistency)
        if faults and (depth.coverage < LEAST_COVERAGE or is_gross):
            self._refuse(frame_set, consistency, faults)
        self._systematic_px = consistency.misfit_px * max(
            1.0, float(np.sqrt(_AVERAGING_AUXILIARIES / len(names)))
        )
        depth = self._add_systematic(depth)
        is_suspect = self._cameras.is_suspect(consistency)
        systematic_mm = depth.systematic_mm
        self._findings.set_checked(
            consistency, faults, names, systematic_mm, used_before=before, is_suspect=is_suspect
        )
        if uses_inconsistent and faults:
            end = f"σ of the depth includes an error of {depth.systematic_mm:.2f} mm common to all pixels"
        else:
            end = f"the depth is measured without {', '.join(self.excluded)}"
        lines = [f"{fault.text}; {end}" for fault in faults]
        if not faults:
            lines = describe_undecided(consistency, self.rig)
        if depth.coverage < LEAST_COVERAGE:
            depth, lines = self._diagnose_coverage(frame_set, depth, consistency)
        return CheckedDepth(depth, consistency, names, tuple(lines))

    def _diagnose_coverage(
        self, frame_set: FrameSet, depth: DepthMap, consistency: RigConsistency
    ) -> tuple[DepthMap, list[str]]:
        """Return the cause of low coverage, and the depth with raised σ if no image fits the rig."""
        cause, is_unreliable = diagnose_low_coverage(
            frame_set, self.rig, consistency, self._near_far, depth.coverage
        )
        if is_unreliable:
            self._findings.set_unreliable(cause)
            self._schedule.request()
            depth = add_systematic_error(depth, (self._near_far[1] - self._near_far[0]) / float(np.sqrt(12)))
        return depth, [cause] if is_unreliable else [cause, *describe_undecided(consistency, self.rig)]

    def _refuse(
        self, frame_set: FrameSet, consistency: RigConsistency, faults: Sequence[CameraFault]
    ) -> None:
        """Raise a ReconstructionError with the faults; the next frame is checked, too."""
        self._schedule.request()
        self._findings.set_refused(consistency, faults)
        raise ReconstructionError(f"frame {frame_set.frame}: {'; '.join(fault.text for fault in faults)}")

    def _explain_failure(self, frame_set: FrameSet) -> None:
        """Raise a ReconstructionError that names the cameras at fault if they explain a frame without a surface."""
        if not self._schedule.is_due(frame_set, None):
            return
        usable = list_usable_auxiliaries(self.rig, frame_set, self._auxiliaries)
        consistency = self._cameras.check(frame_set, None, usable)
        self._schedule.note_check(frame_set, None, has_passed=False)
        faults = self._cameras.diagnose(frame_set, consistency)
        if faults:
            self.is_inconsistent = True
            self._refuse(frame_set, consistency, faults)

    def _select_auxiliaries(self, frame_set: FrameSet) -> tuple[str, ...]:
        """Return the auxiliaries with an image, without the excluded ones unless none remains."""
        usable = list_usable_auxiliaries(self.rig, frame_set, self._auxiliaries)
        return tuple(n for n in usable if n not in self.excluded) or usable

    def _match(self, names: tuple[str, ...], frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        return self._get_matcher(self._select_matcher(names, frame_set)).reconstruct(frame_set, reporter)

    def _select_matcher(self, names: tuple[str, ...], frame_set: FrameSet) -> tuple[str, ...]:
        """Return the auxiliaries of the matcher that matches a frame with these auxiliaries."""
        key = tuple(n for n in self._auxiliaries if n not in self.excluded or n in names)
        return key if set(names) == set(key) & set(frame_set.images) else names

    def _get_matcher(self, auxiliaries: tuple[str, ...]) -> FrameMatcher:
        """Return the matcher of a set of auxiliaries."""
        if auxiliaries not in self._matchers:
            self._matchers[auxiliaries] = self._make_matcher(auxiliaries)
        return self._matchers[auxiliaries]

    def _add_systematic(self, depth: DepthMap) -> DepthMap:
        if not self._systematic_px or not depth.measured.any():
            return depth
        return add_systematic_error(depth, self._systematic_px * compute_depth_error_per_px(self.rig, depth))


def make_sequence_matcher(
    rig: Rig,
    cameras: Collection[str],
    depth_range_mm: tuple[float, float],
    settings: MultiviewSettings,
    propose_rig: Callable[[Rig], None] | None = None,
    watch_points: Callable[[TiePoints], None] | None = None,
) -> CheckedMatcher:
    """Return the matcher of a moving belt; its first frame is checked, and every `CHECK_EVERY`-th after it."""

    def make_matcher(names: tuple[str, ...]) -> MultiviewReconstructor:
        return MultiviewReconstructor(rig, depth_range_mm, settings, auxiliaries=names)

    auxiliaries = tuple(name for name in rig.auxiliaries if name in cameras)
    watchers = propose_rig, watch_points
    return CheckedMatcher(rig, auxiliaries, depth_range_mm, make_matcher, *watchers, every=CHECK_EVERY)
