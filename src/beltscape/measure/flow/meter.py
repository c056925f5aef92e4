"""The flow meter: depth maps of a moving belt in, flow records out, live and offline alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beltscape.core.arguments import require_depth_of
from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding, worst_effect
from beltscape.core.ledger import FlowRecord
from beltscape.measure.belt.reference import EmptyBeltReference, MeasuredLoad
from beltscape.measure.flow.belt_motion import BeltMotion, EncoderScale
from beltscape.measure.flow.blocks import PendingRows, PieceCallback
from beltscape.measure.flow.density import Density, make_unknown_density
from beltscape.measure.flow.foreign_objects import ForeignObjectCheck
from beltscape.measure.flow.fuse import Scatter
from beltscape.measure.flow.location import FramePlacement, Location, MotionPrediction, PushedFrame
from beltscape.measure.flow.motion_evidence import MotionEvidence
from beltscape.measure.flow.motion_tracker import MotionTracker
from beltscape.measure.flow.profile import Profile
from beltscape.measure.flow.registration import HighPassHeights, Shift, compute_high_pass
from beltscape.measure.flow.rows import LayerBuffer, RowFiller
from beltscape.measure.flow.settings import FlowSettings
from beltscape.measure.flow.strip_cutter import FaultAttribution, StripCutter
from beltscape.measure.flow.strips import FlowTotals, Strips, StripSums
from beltscape.measure.flow.travel_direction import TravelDirectionCheck
from beltscape.workers.calls import CallMaker

_COARSE_CELLS = 2
"""Cells of the registration of the material are coarser by this factor."""
_PATIENCE = 8
"""Number of frames held back until the first motion is detected."""
_PATIENCE_BACK = 24
"""The same while the encoder runs back, until it shows whether the belt rolls back; memory bounds it. Chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedDepth:
    """What the meter takes from a depth map alone."""

    high_pass: HighPassHeights
    """By which the material is registered."""
    load: MeasuredLoad
    """What the belt carries in its view."""


def prepare_depth(depth: DepthMap, reference: EmptyBeltReference) -> PreparedDepth:
    """Return what the meter needs of a depth map wherever the belt is; another process may have computed it."""
    height, cell_mm = reference.coarse(depth, _COARSE_CELLS), _COARSE_CELLS * reference.cell_mm
    high_pass = compute_high_pass(height, cell_mm, reference.belt.noise_mm)
    return PreparedDepth(high_pass, reference.measure_load(depth))


class BeltFlowMeter:
    """Measures the flow of a moving belt.

    A record is returned some frames after its frame was pushed: when its strip has left the view and its holes can
    be filled. Memory is bounded by the view, however long the run; the same frames give the same records.
    """

    def __init__(
        self,
        reference: EmptyBeltReference,
        settings: FlowSettings | None = None,
        *,
        density: Density | None = None,
        watch_belt: PieceCallback | None = None,
        watch_step: Callable[[FramePlacement], None] | None = None,
        front_mm: float | None = None,
        scale_sigma: float = 0.0,
        calls: CallMaker | None = None,
    ) -> None:
        """``watch_belt`` receives each finished piece of the fused belt, ``watch_step`` each frame's position.

        ``front_mm`` is a belt coordinate up to which the belt is counted already: of the belt in view at the first
        frame, only the part beyond it is new. It requires an encoder that continued to count. ``scale_sigma`` is
        the relative standard deviation of the rig's lengths (`Rig.scale_sigma`). ``calls`` fills holes beside the
        caller, who then gets the records from `collect`; None: `push` fills them.
        """
        self.reference = reference
        self.settings = settings or FlowSettings()
        self._watch_step = watch_step
        self._waiting: list[PushedFrame] = []
        self._count = 0
        self._cutter = StripCutter(front_mm, reference.seen_mm, self.settings.least_overlap)
        self._width_mm = reference.belt.across_mm[1] - reference.belt.across_mm[0]
        self._sums = StripSums(reference.belt.drift_mm, self._width_mm, scale_sigma)
        self._strips = Strips(self._sums, density or make_unknown_density())
        self._profile = Profile(reference.cell_mm, self.settings.bridge_mm)
        filler = RowFiller(reference, self.settings, watch_belt, calls)
        self._buffer = LayerBuffer(reference, self.settings, filler)
        self._filling: list[PendingRows] = []
        """The blocks that are being filled, in the order of the belt."""
        self._seen_until_mm = -np.inf
        """Up to here the belt has left the view."""
        self._foreign = ForeignObjectCheck(
            _COARSE_CELLS * reference.cell_mm, float(np.ptp(reference.seen_mm))
        )
        self._travel = TravelDirectionCheck(reference.belt)
        self._faults = FaultAttribution(self._strips, self._buffer)
        self._tracker = MotionTracker(reference, self.settings, self._buffer.step_mm, self._foreign)
        self.findings: tuple[Finding, ...] = ()
        """The findings about the encoder of the frames that the last call of `push` placed."""

    def continue_motion(self, motion: MotionPrediction) -> None:
        """Begin, before the first frame, with the motion that another meter of the same belt found."""
        self._tracker.continue_motion(motion)

    def predict_view_start_mm(
        self, clock: float, encoder_mm: float | None, window_mm: tuple[float, float]
    ) -> float:
        """Return the belt coordinate from which on two coming frames would see the belt; inf if it is not known.

        ``window_mm`` is the range of y in which they see it across its width.
        """
        last, motion = self.motion.last, self.prediction
        if last is None or motion is None:
            return np.inf
        ahead = 2 * motion.predict_step_mm(last, clock, encoder_mm)
        return last.position_mm + ahead + self._convert_range(window_mm)[0]

    @property
    def direction(self) -> int:
        """Return the direction of travel: +1 towards +y, -1 towards -y, 0 if not known yet."""
        return 0 if self._tracker.is_assumed else self._tracker.direction

    @property
    def totals(self) -> FlowTotals:
        """Return the totals over the records returned so far."""
        return self._sums.totals

    @property
    def scatter(self) -> Scatter:
        """Return the differences of single frames from the fused belt so far."""
        return self._buffer.scatter

    @property
    def scale(self) -> EncoderScale:
        """Return the encoder's scale against the material so far."""
        return self.motion.scale

    @property
    def motion(self) -> BeltMotion:
        """Return the belt's position and speed."""
        return self._tracker.motion

    @property
    def evidence(self) -> MotionEvidence:
        """Return the evidence for direction and encoder so far."""
        return self._tracker.evidence

    @property
    def follows_encoder(self) -> bool:
        """Return whether the last frame lies where the encoder puts it, and its material does not contradict that."""
        return not self._waiting and self._tracker.follows_encoder

    @property
    def step_mm(self) -> float:
        """Return the travel from which on a further frame is fused with those before, beside the newest one."""
        return self._buffer.step_mm

    @property
    def prediction(self) -> MotionPrediction | None:
        """Return the prediction of the motion after the last frame; None if unknown."""
        return None if self._waiting else self._tracker.prediction

    def push(
        self,
        depth: DepthMap | None,
        time_ns: int | None,
        position_mm: float | None = None,
        *,
        frame: str = "",
        whole: bool = True,
        findings: Sequence[Finding] = (),
        prepared: PreparedDepth | None = None,
    ) -> list[FlowRecord]:
        """Add the next frame and return the records that it completes.

        ``depth`` is None for a frame without a depth map. ``time_ns`` is None without times (then for all frames).
        ``position_mm`` is the encoder's reading, growing with the travel; None without an encoder. A frame that is
        not ``whole``, because a camera gave no image, makes its strip a degraded one. ``findings`` are those of the
        checks of this frame: a fault with the effect "degraded" degrades all strips that the frame measures, one
        with the effect "missing" excludes the frame; both apply back to the last frame that the check passed.
        ``prepared`` is the result of `prepare_depth` for the depth map, where it is known.
        """
        clock = float(self._count) if time_ns is None else time_ns * 1e-9
        name = frame or f"{self._count:03d}"
        if worst_effect(findings) == "missing":
            depth = prepared = None
        if depth is not None:
            require_depth_of(self.reference.camera, depth, f"frame {name}")
            prepared = prepared or prepare_depth(depth, self.reference)
        pushed = PushedFrame(
            name,
            depth,
            time_ns,
            clock,
            position_mm,
            None if prepared is None else prepared.high_pass,
            whole,
            self._count,
            list(findings),
            None if prepared is None else prepared.load,
        )
        # before the findings are attributed, so that the records do not depend on which process fills the holes
        out = self.collect()
        self._faults.add_findings(self._count, findings, self._waiting)
        self._count += 1
        self.findings = ()
        self._waiting.append(pushed)
        if not self._tracker.can_locate(self._waiting):
            return out + self._process_oldest()
        out += [record for one in self._waiting for record in self._process(one)]
        self._waiting = []
        return out

    @property
    def is_filled(self) -> bool:
        """Return whether holes were being filled and `collect` need not wait for them any more."""
        return bool(self._filling) and all(one.is_done for one in self._filling)

    def collect(self) -> list[FlowRecord]:
        """Wait for the holes of the frames so far to be filled, and return the records that this completes."""
        if not self._filling:
            return []
        for pending in self._filling:
            self._profile.add(pending.finish())
        self._filling = []
        return self._pop_finished(self._seen_until_mm)

    def finish(self) -> list[FlowRecord]:
        """Return the remaining records after the last frame."""
        out: list[FlowRecord] = []
        if self._waiting:
            self._tracker.assume_direction(self._waiting)
            out = [record for one in self._waiting for record in self._process(one)]
            self._waiting = []
        out += self.collect()
        for pending in self._buffer.close():
            self._profile.add(pending.finish())
        return out + self._strips.pop_finished(self._profile, np.inf)

    def _process_oldest(self) -> list[FlowRecord]:
        """Process the oldest waiting frame without a first motion once too many frames wait."""
        patience = _PATIENCE_BACK if self._tracker.may_roll_back(self._waiting) else _PATIENCE
        if len(self._waiting) <= patience:
            return []
        oldest = self._waiting.pop(0)
        if oldest.encoder_mm is None:
            self._check_travel_direction(oldest, None)
            self._strips.add(self._cutter.make_unplaced_strip(oldest))
            return self._pop_finished()
        self._tracker.assume_direction([oldest, *self._waiting])
        out = self._process(oldest)
        for one in self._waiting:
            out += self._process(one)
        self._waiting = []
        return out

    def _process(self, frame: PushedFrame) -> list[FlowRecord]:
        """Locate a frame, add its layer to the buffer, and cut its strip."""
        out, before = self.collect(), self.motion.last
        location = self._tracker.locate(frame)
        place = location.place
        self._check_travel_direction(frame, location.shift)
        if location.has_turned:
            self._buffer.clear()
        self._relocate(location)
        if place is None:
            self._strips.add(self._cutter.make_unplaced_strip(frame))
            return out + self._pop_finished()
        if self._watch_step is not None:
            self._watch_step(FramePlacement(frame.frame, place, location.shift, location.is_encoder_trusted))
        view_start = np.inf
        if location.is_stalled and location.finding is not None:
            frame.findings.append(location.finding)
            self._tracker.update_key(frame, location)
        if frame.load is not None and frame.is_measured:
            blur = place.sigma_mm if place.source == "speed" else 0.0
            layer = self.reference.place(frame.load, place.position_mm, self._tracker.direction, blur)
            self._buffer.add(replace(layer, frame=frame.number), place.position_mm)
            self._tracker.update_key(frame, location)
            self._leave_out_foreign_objects(frame, location)
            view_start = layer.first * self.reference.cell_mm
        strip = self._cutter.cut(frame, place, before, self._convert_range(self.reference.window_mm))
        strip.reliable &= not location.is_sudden
        if (finding := self._cutter.find_thin_overlap()) is not None:
            self.findings = (*self.findings, finding)
            frame.findings.append(finding)
        self._faults.attach(strip, frame, view_start)
        self._strips.add(strip)
        self._add_encoder_finding(frame, location)
        self._seen_until_mm = place.position_mm + self._convert_range(self.reference.seen_mm)[0]
        self._filling = self._buffer.fuse_until(self._seen_until_mm)
        if not self._filling:
            return out + self._pop_finished(self._seen_until_mm)
        return out + (self.collect() if self.is_filled else [])

    def _check_travel_direction(self, frame: PushedFrame, shift: Shift | None) -> None:
        """Degrade the frame's strip where the material does not move along the belt's axis."""
        if frame.high_pass is None or not frame.is_measured:
            return
        finding = self._travel.follow(frame.high_pass, shift)
        self.findings = (*self.findings, finding)
        frame.findings.append(finding)
        self._faults.add_findings(frame.number, (finding,))

    def _leave_out_foreign_objects(self, frame: PushedFrame, location: Location) -> None:
        """Leave what does not travel with the belt out of this frame's layer and of earlier ones."""
        if frame.high_pass is None:
            return
        direction = self._tracker.direction
        found = self._foreign.follow(frame.number, frame.high_pass.surface_mm, location, direction)
        for number, cells in found.masks.items():
            self._buffer.leave_out(number, cells, direction)
            self._tracker.leave_out(number, cells)
        self.findings = (*self.findings, found.finding)
        frame.findings.append(found.finding)
        self._faults.add_findings(frame.number, (found.finding,))

    def _relocate(self, location: Location) -> None:
        """Give earlier frames, their layers and their strips the positions that a contradiction showed."""
        if not location.relocated:
            return
        places = {one.number: one.place for one in location.relocated}
        self._cutter.recut(self._strips, places, self._convert_range(self.reference.window_mm)[1])
        self._buffer.move({one.number: one.moved_mm for one in location.relocated})
        if self._watch_step is not None:
            for one in location.relocated:
                self._watch_step(FramePlacement(one.frame, one.place, None, is_encoder_trusted=False))

    def _add_encoder_finding(self, frame: PushedFrame, location: Location) -> None:
        """Attribute the encoder's finding to the frame's strip and to those before it that it concerns."""
        if location.finding is not None:
            self.findings = (*self.findings, location.finding)
        if location.finding is None or location.is_stalled:
            return
        contradiction = location.contradiction
        first = frame.number if contradiction is None else min(contradiction.first, frame.number)
        self._faults.add_since(first, location.finding)

    def _convert_range(self, range_mm: tuple[float, float]) -> tuple[float, float]:
        """Return the ends of a range of y as belt coordinates of a frame at position 0, the older end first."""
        low, high = sorted(-self._tracker.direction * y for y in range_mm)
        return low, high

    def _pop_finished(self, seen_until_mm: float = -np.inf) -> list[FlowRecord]:
        """Return the records whose strips are complete; a gap too long to bridge completes them at once."""
        end = self._profile.end_mm
        until = -np.inf if end is None else end - self.reference.cell_mm
        begins = min(seen_until_mm, self._buffer.open_mm)
        if end is not None and begins - end > self.settings.bridge_mm:
            until = begins
        out = self._strips.pop_finished(self._profile, until)
        if self._strips.first is not None and np.isfinite(self._strips.first.start_mm):
            self._profile.discard_before(self._strips.first.start_mm)
        return out
