"""The flow meter: depth maps of a moving belt in, flow records out, live and offline alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beltscape.core.arguments import require_depth_of
from beltscape.core.belt.flow_record import FlowRecord
from beltscape.core.depth import DepthMap
from beltscape.core.finding import Finding, worst_effect
from beltscape.measure.flow.fusion.buffer import LayerBuffer
from beltscape.measure.flow.fusion.empty_belt_reference import EmptyBeltReference
from beltscape.measure.flow.fusion.fuse import Scatter
from beltscape.measure.flow.fusion.rows import PieceCallback, RowFiller
from beltscape.measure.flow.motion.belt_motion import (
    MAX_DISAGREEMENT,
    BeltMotion,
    BeltPosition,
    MotionObservation,
)
from beltscape.measure.flow.motion.encoder_scale import EncoderScale
from beltscape.measure.flow.motion.evidence import MotionEvidence
from beltscape.measure.flow.motion.high_pass import HighPassHeights, compute_high_pass
from beltscape.measure.flow.motion.prediction import MotionPrediction
from beltscape.measure.flow.motion.registration import Shift, register
from beltscape.measure.flow.pushed_frame import PushedFrame
from beltscape.measure.flow.records.density import Density, make_unknown_density
from beltscape.measure.flow.records.fault_attribution import FaultAttribution
from beltscape.measure.flow.records.profile import Profile
from beltscape.measure.flow.records.strips import Strips
from beltscape.measure.flow.records.totals import FlowTotals, Sums
from beltscape.measure.flow.settings import FlowSettings
from beltscape.measure.flow.strip_cutter import StripCutter

_COARSE_CELLS = 2
"""Cells of the registration are coarser by this factor."""
_PATIENCE = 8
"""Number of frames held back until the first motion is detected."""
_LEAST_MOTION_MM = 2.0
"""A shorter motion does not determine the direction."""


@dataclass(frozen=True, slots=True)
class FramePlacement:
    """The position assigned to one frame."""

    frame: str
    place: BeltPosition
    shift: Shift | None
    """Motion of the material since the key frame."""


class FlowMeter:
    """Measures the flow of a moving belt.

    A record is returned some frames after its frame was pushed: when its strip has left the view and its holes can
    be filled. Memory is bounded by the view, however long the run; the same frames give the same records.
    """

    def __init__(
        self,
        ground: EmptyBeltReference,
        settings: FlowSettings | None = None,
        *,
        density: Density | None = None,
        watch_belt: PieceCallback | None = None,
        watch_step: Callable[[FramePlacement], None] | None = None,
        front_mm: float | None = None,
    ) -> None:
        """``watch_belt`` receives each finished piece of the fused belt, ``watch_step`` each frame's position.

        ``front_mm`` is a belt coordinate up to which the belt is counted already: of the belt in view at the first
        frame, only the part beyond it is new. It requires an encoder that continued to count.
        """
        self.ground = ground
        self.settings = settings or FlowSettings()
        self.motion = BeltMotion()
        self.evidence = MotionEvidence()
        given_direction = self.settings.direction
        self._direction = 0 if given_direction is None else 1 if given_direction == "+y" else -1
        self._assumed = False
        self._watch_step = watch_step
        self._waiting: list[PushedFrame] = []
        self._key_high_pass: HighPassHeights | None = None
        self._count = 0
        self._cutter = StripCutter(front_mm)
        self._width_mm = ground.belt.across_mm[1] - ground.belt.across_mm[0]
        self._sums = Sums(ground.belt.drift_mm, self._width_mm)
        self._strips = Strips(self._sums, density or make_unknown_density())
        self._profile = Profile(ground.cell_mm, self.settings.bridge_mm)
        self._buffer = LayerBuffer(ground, self.settings, RowFiller(ground, self.settings, watch_belt))
        self._faults = FaultAttribution(self._strips, self._buffer)

    @property
    def direction(self) -> int:
        """Return the direction of travel: +1 towards +y, -1 towards -y, 0 if not known yet."""
        return 0 if self._assumed else self._direction

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
    def prediction(self) -> MotionPrediction | None:
        """Return the prediction of the motion after the last frame; None if unknown."""
        motion = self.motion
        if motion.last is None or not self._direction or self._waiting:
            return None
        along = self._direction * self.ground.belt.belt_from_core.rotation[1]
        return MotionPrediction(along, motion.scale.ratio, motion.speed)

    def push(
        self,
        depth: DepthMap | None,
        time_ns: int | None,
        position_mm: float | None = None,
        *,
        frame: str = "",
        whole: bool = True,
        findings: Sequence[Finding] = (),
    ) -> list[FlowRecord]:
        """Add the next frame and return the records that it completes.

        ``depth`` is None for a frame without a depth map. ``time_ns`` is None without times (then for all frames).
        ``position_mm`` is the encoder's reading, growing with the travel; None without an encoder. A frame that is
        not ``whole``, because a camera gave no image, makes its strip a degraded one. ``findings`` are those of the
        checks of this frame: a fault with the effect "degraded" degrades all strips that the frame measures, one
        with the effect "missing" excludes the frame; both apply back to the last frame that the check passed.
        """
        clock = float(self._count) if time_ns is None else time_ns * 1e-9
        name = frame or f"{self._count:03d}"
        if worst_effect(findings) == "missing":
            depth = None
        if depth is not None:
            require_depth_of(self.ground.camera, depth, f"frame {name}")
            self._sums.add_systematic(depth.systematic_mm)
        pushed = PushedFrame(
            name, depth, time_ns, clock, position_mm, self._filter(depth), whole, self._count, list(findings)
        )
        self._faults.add_findings(self._count, findings, self._waiting)
        self._count += 1
        self._waiting.append(pushed)
        if not self._can_locate():
            return self._process_oldest()
        out = [record for one in self._waiting for record in self._process(one)]
        self._waiting = []
        return out

    def finish(self) -> list[FlowRecord]:
        """Return the remaining records after the last frame."""
        out: list[FlowRecord] = []
        if self._waiting:
            self._direction, self._assumed = self._direction or 1, not self._direction
            out = [record for one in self._waiting for record in self._process(one)]
            self._waiting = []
        for rows in self._buffer.close():
            self._profile.add(rows)
        return out + self._strips.pop_finished(self._profile, np.inf)

    def _filter(self, depth: DepthMap | None) -> HighPassHeights | None:
        if depth is None:
            return None
        height = self.ground.coarse(depth, _COARSE_CELLS)
        return compute_high_pass(height, _COARSE_CELLS * self.ground.cell_mm, self.ground.belt.noise_mm)

    def _can_locate(self) -> bool:
        """Return whether frames can be placed: by a known motion, by an encoder, or by a first motion found now."""
        newest = self._waiting[-1]
        if self.motion.key is not None:
            return True
        if self._direction and newest.encoder_mm is not None:
            return True
        before = next((one for one in self._waiting[-2::-1] if one.high_pass is not None), None)
        if before is None or before.high_pass is None or newest.high_pass is None:
            return False
        shift = register(before.high_pass, newest.high_pass, least_overlap=self.settings.least_overlap)
        if shift is None or abs(shift.along_mm) < max(_LEAST_MOTION_MM, 3 * shift.sigma_mm):
            return False
        forward = 1 if newest.encoder_mm is None or newest.encoder_mm >= (before.encoder_mm or 0.0) else -1
        self._direction = self._direction or forward * (1 if shift.along_mm > 0 else -1)
        if newest.encoder_mm is None and newest.clock > before.clock:
            self.motion.speed = self._direction * shift.along_mm / (newest.clock - before.clock)
        return True

    def _process_oldest(self) -> list[FlowRecord]:
        """Process the oldest waiting frame without a first motion once too many frames wait."""
        if len(self._waiting) <= _PATIENCE:
            return []
        oldest = self._waiting.pop(0)
        if oldest.encoder_mm is None:
            self._strips.add(self._cutter.make_unplaced_strip(oldest))
            return self._pop_finished()
        # an empty or standing belt: both directions are equivalent until the material determines one
        self._direction, self._assumed = 1, True
        out = self._process(oldest)
        for one in self._waiting:
            out += self._process(one)
        self._waiting = []
        return out

    def _process(self, frame: PushedFrame) -> list[FlowRecord]:
        """Locate a frame, add its layer to the buffer, and cut its strip."""
        before = self.motion.last
        shift = self._register(frame)
        observation = MotionObservation(
            frame.clock,
            frame.encoder_mm,
            None if shift is None else self._direction * shift.along_mm,
            0.0 if shift is None else shift.sigma_mm,
        )
        place = None if before is None and frame.depth is None else self.motion.locate(observation)
        if place is None:
            self._strips.add(self._cutter.make_unplaced_strip(frame))
            return self._pop_finished()
        if self._watch_step is not None:
            self._watch_step(FramePlacement(frame.frame, place, shift))
        view_start = np.inf
        if frame.depth is not None and frame.is_measured:
            blur = place.sigma_mm if place.source == "speed" else 0.0
            layer = self.ground.layer(frame.depth, place.position_mm, self._direction, blur)
            self._buffer.add(replace(layer, frame=frame.number), place.position_mm)
            self._update_key(frame, place)
            view_start = layer.first * self.ground.cell_mm
        strip = self._cutter.cut(frame, place, before, self._convert_range(self.ground.window_mm))
        self._faults.attach(strip, frame, view_start)
        self._strips.add(strip)
        seen_until = place.position_mm + self._convert_range(self.ground.seen_mm)[0]
        for rows in self._buffer.fuse_until(seen_until):
            self._profile.add(rows)
        return self._pop_finished(seen_until)

    def _register(self, frame: PushedFrame) -> Shift | None:
        """Return the motion since the key frame, and reverse a direction that was only assumed if necessary."""
        if self._key_high_pass is None or frame.high_pass is None:
            return None
        expected = self.motion.predict_mm(frame.clock, frame.encoder_mm)
        low, high = self.ground.seen_mm
        reach = (1 - self.settings.least_overlap) * (high - low)
        apart = frame.encoder_mm is not None and (1 - MAX_DISAGREEMENT) * abs(expected or 0.0) > reach
        near = None if expected is None or self._assumed or apart else self._direction * expected
        shift = register(
            self._key_high_pass, frame.high_pass, least_overlap=self.settings.least_overlap, near_mm=near
        )
        if shift is None:
            return None
        if self._assumed and not apart and abs(shift.along_mm) > _LEAST_MOTION_MM:
            self._assumed = False
            if self._direction * shift.along_mm < 0:
                self._direction = -self._direction
                self._buffer.clear()
        self._count_evidence(shift, frame, apart)
        # by the encoder the views do not overlap: then a similar surface is other material
        return None if apart else shift

    def _count_evidence(self, shift: Shift, frame: PushedFrame, apart: bool) -> None:
        """Count the motion since the key frame as evidence, together with the raw encoder's step."""
        key = self.motion.key
        step = None
        if key is not None and key.encoder_mm is not None and frame.encoder_mm is not None:
            step = frame.encoder_mm - key.encoder_mm
        self.evidence.add(shift, self._direction, step, apart=apart)

    def _update_key(self, frame: PushedFrame, place: BeltPosition) -> None:
        """Make the frame the key frame once the belt has moved, unless only the old one has load and overlaps."""
        key = self.motion.key
        moved = abs(place.position_mm - key.position_mm) if key is not None else np.inf
        low, high = self.ground.seen_mm
        has_load = frame.high_pass is not None and frame.high_pass.has_load
        kept = self._key_high_pass is not None and self._key_high_pass.has_load
        is_out_of_view = moved > (1 - self.settings.least_overlap) * (high - low)
        if (
            self._key_high_pass is None
            or (moved >= self._buffer.step_mm and (has_load or not kept))
            or is_out_of_view
        ):
            self.motion.move_key()
            self._key_high_pass = frame.high_pass

    def _convert_range(self, range_mm: tuple[float, float]) -> tuple[float, float]:
        """Return the ends of a range of y as belt coordinates of a frame at position 0, the older end first."""
        low, high = sorted(-self._direction * y for y in range_mm)
        return low, high

    def _pop_finished(self, seen_until_mm: float = -np.inf) -> list[FlowRecord]:
        """Return the records whose strips are complete; a gap too long to bridge completes them at once."""
        end = self._profile.end_mm
        until = -np.inf if end is None else end - self.ground.cell_mm
        begins = min(seen_until_mm, self._buffer.open_mm)
        if end is not None and begins - end > self.settings.bridge_mm:
            until = begins
        out = self._strips.pop_finished(self._profile, until)
        if self._strips.first is not None and np.isfinite(self._strips.first.start_mm):
            self._profile.discard_before(self._strips.first.start_mm)
        return out
