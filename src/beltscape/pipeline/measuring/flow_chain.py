"""The chain of matcher and flow meter that turns frame sets into flow records, live and offline alike.

It refuses an empty belt that was reconstructed with another rig than the one in use.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError, ReconstructionError
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig, pinhole_scale
from beltscape.core.ledger import FlowRecord
from beltscape.core.progress import Reporter
from beltscape.files.rig_json import read_rig
from beltscape.health.belt.monitor import BeltMonitor
from beltscape.health.images.belt_images import BeltImageMonitor
from beltscape.health.settings import BeltLimits
from beltscape.measure.belt.reference import EmptyBeltReference, make_reference
from beltscape.measure.belt.settings import NOTHING_GIVEN, GivenBelt
from beltscape.measure.flow.meter import BeltFlowMeter
from beltscape.pipeline.measuring.belt import read_empty_belt
from beltscape.pipeline.reconstructing.checked_matcher import SequenceMatcher
from beltscape.pipeline.reconstructing.frame_measurements import FrameMeasurements, MeasurementRequest
from beltscape.pipeline.reconstructing.monitored_matcher import MonitoredMatcher, PendingFrame
from beltscape.workers.transport import SharedObject

_OTHER_RAD = 1.5e-3
"""Another rig: 1 px at 600 px of focal length; calibrations of one rig differ by a tenth of it."""
_MOVED_RAD = 3e-4
"""The camera has moved, or the calibration was repeated, since the empty belt was reconstructed."""
_COMPARED_POINTS = 5
"""Rows and columns of the points that are compared."""


def require_same_rig(empty: Path, rig: Rig, depth_mm: float, reporter: Reporter) -> None:
    """Compare the auxiliaries' poses with those of the rig.json beside the empty belt's frames, if there is one.

    Raises
    ------
    InputError
        When they are those of another rig.
    """
    path = _find_rig(empty)
    if path is None:
        return
    learned = read_rig(path)
    angles = {
        name: _compute_angle(rig, learned, name, depth_mm)
        for name in rig.auxiliaries
        if name in learned.auxiliaries
    }
    if not angles:
        return
    name = max(angles, key=lambda each: angles[each])
    degrees = np.rad2deg(angles[name])
    differs = f"{empty}: its rig.json and the rig given differ by {degrees:.2f}° in the view of {name}"
    if angles[name] > _OTHER_RAD:
        raise InputError(
            f"{differs}: it was reconstructed with another rig; reconstruct the empty belt with the rig.json given "
            "here, or give the rig.json that belongs to it"
        )
    if angles[name] > _MOVED_RAD:
        reporter.warn(f"{differs}; reconstruct the empty belt again with the rig.json given here")


def _find_rig(empty: Path) -> Path | None:
    """Return the rig.json of a reconstruction or of one of its frames; None for a belt.json."""
    if empty.is_file():
        return None
    return next((path for path in (empty / "rig.json", empty.parent / "rig.json") if path.is_file()), None)


def _compute_angle(rig: Rig, other: Rig, name: str, depth_mm: float) -> float:
    """Return the RMS angle between the directions in which two rigs' auxiliary sees points at a depth, rad."""
    core = rig.core_camera
    width, height = core.size_px
    u, v = np.meshgrid(
        np.linspace(0, width - 1, _COMPARED_POINTS), np.linspace(0, height - 1, _COMPARED_POINTS)
    )
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    rays: NDArray[np.float64] = (pixels - core.center_px) / core.focal_px
    points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * depth_mm
    directions = [_normalise(each.cam_from_core[name].apply(points)) for each in (rig, other)]
    difference = directions[0] - directions[1]
    return float(np.sqrt(3 * np.mean(difference * difference)))


def _normalise(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (N, 3) at the length 1."""
    return points / np.linalg.norm(points, axis=1, keepdims=True)


_OF_VIEW = ("foreign_object", "foreign_object_alone", "thin_overlap", "encoder_stalled")
"""Causes of the meter's findings that are warned of; `flow_checks` judges other contradictions over all frames."""
_MARGIN = 0.02
"""Relative margin of the searched depth range around the empty belt's depths."""


@dataclass(frozen=True, slots=True, eq=False)
class ChainResult:
    """The result of one frame set."""

    depth: DepthMap | None
    """Depth map; None if the frame could not be reconstructed."""
    records: list[FlowRecord]
    """The records that this frame set completed."""
    findings: tuple[Finding, ...] = ()
    """The findings about this frame set, and those of the meter about the frame set before."""


@dataclass(frozen=True, slots=True, eq=False)
class _MatchedFrame:
    """A frame that is matched but not measured yet."""

    frames: FrameSet
    depth: DepthMap | None
    whole: bool
    findings: tuple[Finding, ...]
    """Findings about the frame, before it is measured."""
    measurements: tuple[MeasurementRequest, FrameMeasurements] | None = None
    """What was requested of the frame, and measured, when it was matched; None: nothing."""


class FlowChain:
    """Runs matcher and meter in parallel: while a frame is matched, the one before it is measured.

    Neither thread timing nor `flush` changes a result, because matching a frame takes nothing from the meter.
    """

    def __init__(
        self,
        matcher: SequenceMatcher,
        meter: BeltFlowMeter,
        belt_limits: BeltLimits | None = None,
        images: BeltImageMonitor | None = None,
    ) -> None:
        """``belt_limits`` are those of the comparison of the bare belt with the learned one.

        ``images`` checks the images against the measured surface and motion; None: they are not checked.
        """
        self.meter: BeltFlowMeter = meter
        self._reference = SharedObject(meter.reference)
        """The empty belt of the next requests."""
        self.done = 0
        """Number of frame sets that were reconstructed."""
        self.failure: ReconstructionError | None = None
        """Error of the last frame set that could not be reconstructed."""
        self._matcher = matcher
        self._matching = ThreadPoolExecutor(1, "matcher")
        self._waiting: _MatchedFrame | None = None
        """The previous frame while it is not measured yet."""
        self._early: list[FlowRecord] = []
        """Records of frames that were measured by `pass_over`, for the next call of `flush`."""
        self._findings: list[Finding] = []
        """The findings about heights and motion since the last `pop_findings`."""
        self._belt_limits = belt_limits
        self._belt = BeltMonitor(meter.reference, belt_limits)
        self._images = images
        self._image_findings: tuple[Finding, ...] = ()
        """The findings of ``images`` about that frame."""
        self._reported: set[tuple[str, str]] = set()

    def push(
        self,
        frames: FrameSet,
        reporter: Reporter,
        *,
        whole: bool,
        findings: Sequence[Finding] = (),
        pending: PendingFrame | None = None,
    ) -> ChainResult:
        """Match the next frame set and measure the one before; without usable images it gives the belt position only.

        ``whole``: all cameras are in it. ``findings`` are those about its images. ``pending`` is its match, where it
        was begun ahead. The records are those of the frame before.
        """
        matching = self._matching.submit(self._match, frames, pending, reporter)
        try:
            records = self.flush()
        finally:
            depth = matching.result()
        self._report(reporter)
        cameras = self._matcher.findings if frames.images else ()
        self._waiting = _MatchedFrame(
            frames,
            depth,
            whole and not (self._matcher.is_inconsistent and depth is not None),
            (*findings, *cameras),
            None if pending is None else pending.find_measurements(depth),
        )
        return ChainResult(depth, records, (*findings, *cameras, *self.pop_findings()))

    def check_repeat(
        self, frames: FrameSet, reporter: Reporter, pending: PendingFrame | None, *, has_moved: bool
    ) -> bool:
        """Check the images of a frame set that the encoder puts beside the last matched one; return if it may pass.

        It must be pushed while the encoder is in doubt, or where its images show something new. ``has_moved``: the
        encoder has counted since the frame before. That one is measured first, so that no thread decides.
        """
        self._early = self.flush()
        self._report(reporter)
        if not self.meter.follows_encoder or not isinstance(self._matcher, MonitoredMatcher):
            return False
        return self._matcher.check_repeat(frames, pending, has_moved=has_moved)

    def pass_over(self, frames: FrameSet, reporter: Reporter) -> ChainResult:
        """Leave out the match of the frame set that `check_repeat` checked."""
        assert isinstance(self._matcher, MonitoredMatcher)
        self._matcher.pass_over(frames, reporter)
        return ChainResult(None, self.flush(), (*self._matcher.findings, *self.pop_findings()))

    def expect(self, frames: FrameSet, ahead: int, reference: EmptyBeltReference) -> MeasurementRequest:
        """Return what will probably be needed of a frame set, before which ``ahead`` others are still to be pushed.

        ``reference`` is the empty belt that it will be measured against.
        """
        samples = None
        if self._images is not None:
            samples = self._images.expect(frames, ahead + (self._waiting is not None))
        if self._reference.value is not reference:
            self._reference = SharedObject(reference)
        return MeasurementRequest(self._reference, self._belt.limits, samples, ahead)

    def _get_known(self, one: _MatchedFrame) -> FrameMeasurements | None:
        """Return what was measured of a frame against the present empty belt."""
        if one.measurements is None or one.measurements[0].reference.value is not self.meter.reference:
            return None
        return one.measurements[1]

    def flush(self) -> list[FlowRecord]:
        """Measure the pending frame without waiting for the next one."""
        early, self._early = self._early, []
        one, self._waiting = self._waiting, None
        return early if one is None else early + self._measure(one)

    def _measure(self, one: _MatchedFrame) -> list[FlowRecord]:
        """Measure a frame that is matched; return the records that it completes."""
        known = self._get_known(one)
        # the instants are those of the frame before
        delays = () if self._images is None else self._images.complete_synchronisation()
        self._image_findings = (*self._check_projector(one), *delays)
        bare_belt = self._belt.check(one.depth, None if known is None else known.bare_belt)
        heights = (*bare_belt, *self._image_findings)
        records = self.meter.push(
            one.depth,
            one.frames.time_ns,
            one.frames.position_mm,
            frame=one.frames.frame,
            whole=one.whole,
            findings=(*one.findings, *heights),
            prepared=None if known is None else known.prepared,
        )
        last = self.meter.motion.last
        # an empty belt shows no direction: positions on it are then off by less than the view
        direction = self.meter.direction or 1
        marks = self._belt.follow(None if last is None else last.position_mm, direction)
        self._findings += (*heights, *marks, *self.meter.findings)
        self._begin_delays(one)
        return records

    def _report(self, reporter: Reporter) -> None:
        """Warn of the first fault of every check of the last measured frame, of every camera."""
        of_view = (one for one in self.meter.findings if one.cause in _OF_VIEW)
        for one in (*self._image_findings, *of_view):
            if one.is_fault and (one.check, one.subject) not in self._reported:
                self._reported.add((one.check, one.subject))
                reporter.warn(one.text)

    def _check_projector(self, one: _MatchedFrame) -> tuple[Finding, ...]:
        if self._images is None:
            return ()
        bare_belt = None
        if one.measurements is not None and one.depth is not None:
            request, measured = one.measurements
            if request.samples is not None and measured.samples is not None:
                bare_belt = self._images.adopt(one.frames, one.depth, request.samples, measured.samples)
        return self._images.check_projector(one.frames, one.depth, one.findings, bare_belt)

    def _begin_delays(self, one: _MatchedFrame) -> None:
        """Begin to check the cameras' instants; the next frame's records receive the findings."""
        last, prediction = self.meter.motion.last, self.meter.prediction
        if self._images is None:
            return
        position = None if last is None or one.depth is None else last.position_mm
        along = None if prediction is None else prediction.along
        self._images.begin_synchronisation(one.frames, one.depth, position, along, one.findings)

    def pop_findings(self) -> tuple[Finding, ...]:
        """Remove and return the findings about measured frames."""
        findings, self._findings = tuple(self._findings), []
        return findings

    def finish(self) -> list[FlowRecord]:
        """Return the remaining records after the last frame."""
        return self.flush() + self.meter.finish()

    def restart(self, meter: BeltFlowMeter) -> None:
        """Continue with another meter after `finish`."""
        if meter.reference is not self.meter.reference:
            self._belt = BeltMonitor(meter.reference, self._belt_limits)
        self.meter = meter

    def _match(self, frames: FrameSet, pending: PendingFrame | None, reporter: Reporter) -> DepthMap | None:
        if not frames.images:
            return None
        try:
            depth = (
                self._matcher.reconstruct(frames, reporter) if pending is None else pending.complete(reporter)
            )
        except ReconstructionError as error:
            self.failure = error
            reporter.warn(f"{error}; going on without this frame")
            return None
        self.done += 1
        return depth


def read_reference(
    empty: Path, rig: Rig, cell_mm: float | None, reporter: Reporter, given: GivenBelt = NOTHING_GIVEN
) -> EmptyBeltReference:
    """Return the empty-belt reference for the rig's depth maps; ``given`` limits the belt, see `GivenBelt`.

    A warning names an empty belt that was learned from images of another size.

    Raises
    ------
    InputError, MeasureError
        When it was reconstructed with another rig, or shows no belt.
    """
    belt, camera = read_empty_belt(empty, reporter, given)
    if camera.name != rig.core or pinhole_scale(camera, rig.core_camera) is None:
        raise InputError(
            f"{empty}: reconstructed with another rig; reconstruct the empty belt with the rig.json given here"
        )
    reference = make_reference(belt, rig.core_camera, cell_mm)
    learned, own = camera.size_px[0], rig.core_camera.size_px[0]
    if learned != own:
        reporter.warn(
            f"{empty}: learned from images {learned} px wide, measured in images {own} px wide: the zero is "
            f"uncertain by {reference.other_size_mm:.2f} mm; measure at width_px = {learned}, or learn the belt from "
            f"images {own} px wide"
        )
    require_same_rig(empty, rig, sum(reference.depths_mm()) / 2, reporter)
    return reference


def compute_depth_range(ground: EmptyBeltReference, load_mm: float) -> tuple[float, float]:
    """Return the near and far depth of a belt that is loaded up to ``load_mm``."""
    near, far = ground.depths_mm()
    return (1 - _MARGIN) * max(near - load_mm, 0.1 * near), (1 + _MARGIN) * far


def widen_to_belt(ground: EmptyBeltReference, near_far_mm: tuple[float, float]) -> tuple[float, float]:
    """Return a depth range found in images, extended to contain the empty belt."""
    low, high = ground.depths_mm()
    return min(near_far_mm[0], (1 - _MARGIN) * low), max(near_far_mm[1], (1 + _MARGIN) * high)
