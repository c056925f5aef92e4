"""Depth maps of a moving belt, one after the other → flow records: the same live and offline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beltscape.core.arguments import require_depth_of
from beltscape.core.belt.flow_record import FlowRecord
from beltscape.core.depth import DepthMap
from beltscape.measure.flow.cut import StripCutter
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
from beltscape.measure.flow.records.density import Density, make_unknown_density
from beltscape.measure.flow.records.profile import Profile
from beltscape.measure.flow.records.strips import Strips
from beltscape.measure.flow.records.totals import FlowTotals, Sums
from beltscape.measure.flow.seen import PushedFrame
from beltscape.measure.flow.settings import FlowSettings

_COARSE_CELLS = 2
"""The motion is looked for on cells so many times as large."""
_PATIENCE = 8
"""Frames that wait for the first motion before they are taken as they are."""
_LEAST_MOTION_MM = 2.0
"""A shorter motion does not tell the direction."""


@dataclass(frozen=True, slots=True)
class Step:
    """How one frame was placed."""

    frame: str
    place: BeltPosition
    shift: Shift | None
    """BeltMotion since the key frame as the material tells it."""


class FlowMeter:
    """Measures what passes.

    A record comes back some frames after its frame was pushed: when its strip has left the view and its holes can
    be filled. Memory is bounded by the view, however long the run; the same frames give the same records.
    """

    def __init__(
        self,
        ground: EmptyBeltReference,
        settings: FlowSettings | None = None,
        *,
        density: Density | None = None,
        watch_belt: PieceCallback | None = None,
        watch_step: Callable[[Step], None] | None = None,
        front_mm: float | None = None,
    ) -> None:
        """``watch_belt`` is given each finished piece of the fused belt, ``watch_step`` each frame's place.

        ``front_mm`` is a belt coordinate up to which the belt is counted already: of what is in view at the first
        frame, only what lies beyond is new. It needs an encoder that went on counting.
        """
        self.ground = ground
        self.settings = settings or FlowSettings()
        self.motion = BeltMotion()
        self.evidence = MotionEvidence()
        told = self.settings.direction
        self._direction = 0 if told is None else 1 if told == "+y" else -1
        self._assumed = False
        self._watch_step = watch_step
        self._waiting: list[PushedFrame] = []
        self._key_relief: HighPassHeights | None = None
        self._count = 0
        self._cutter = StripCutter(front_mm)
        self._width_mm = ground.belt.across_mm[1] - ground.belt.across_mm[0]
        self._sums = Sums(ground.belt.drift_mm, self._width_mm)
        self._strips = Strips(self._sums, density or make_unknown_density())
        self._profile = Profile(ground.cell_mm, self.settings.bridge_mm)
        self._buffer = LayerBuffer(ground, self.settings, RowFiller(ground, self.settings, watch_belt))

    @property
    def direction(self) -> int:
        """+1: towards +y, -1: towards -y, 0: not known yet."""
        return 0 if self._assumed else self._direction

    @property
    def totals(self) -> FlowTotals:
        """Over the records given so far."""
        return self._sums.totals

    @property
    def scatter(self) -> Scatter:
        """How single frames differ from the fused belt so far."""
        return self._buffer.scatter

    @property
    def scale(self) -> EncoderScale:
        """Encoder against material so far."""
        return self.motion.scale

    @property
    def prediction(self) -> MotionPrediction | None:
        """How the belt should move on after the last frame; None: not known."""
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
    ) -> list[FlowRecord]:
        """The next frame; the records that are finished with it.

        ``depth`` is None for a frame that gave none, ``time_ns`` where nobody told the time (then no frame may have
        one), ``position_mm`` is the encoder's and grows with the travel; None where there is none. A frame that is
        not ``whole``, for a camera gave it no image, makes its strip a degraded one.
        """
        clock = float(self._count) if time_ns is None else time_ns * 1e-9
        name = frame or f"{self._count:03d}"
        if depth is not None:
            require_depth_of(self.ground.camera, depth, f"frame {name}")
            self._sums.add_systematic(depth.systematic_mm)
        seen = PushedFrame(name, depth, time_ns, clock, position_mm, self._relief(depth), whole)
        self._count += 1
        self._waiting.append(seen)
        if not self._started():
            return self._impatient()
        out = [record for one in self._waiting for record in self._take(one)]
        self._waiting = []
        return out

    def finish(self) -> list[FlowRecord]:
        """No more frames come: the records that are left."""
        out: list[FlowRecord] = []
        if self._waiting:
            self._direction, self._assumed = self._direction or 1, not self._direction
            out = [record for one in self._waiting for record in self._take(one)]
            self._waiting = []
        for rows in self._buffer.close():
            self._profile.add(rows)
        return out + self._strips.pop_finished(self._profile, np.inf)

    def _relief(self, depth: DepthMap | None) -> HighPassHeights | None:
        if depth is None:
            return None
        height = self.ground.coarse(depth, _COARSE_CELLS)
        return compute_high_pass(height, _COARSE_CELLS * self.ground.cell_mm, self.ground.belt.noise_mm)

    def _started(self) -> bool:
        """Whether direction and speed, or an encoder, are known: else the first motion is looked for."""
        newest = self._waiting[-1]
        if self.motion.key is not None:
            return True
        if self._direction and newest.encoder_mm is not None:
            return True
        before = next((one for one in self._waiting[-2::-1] if one.relief is not None), None)
        if before is None or before.relief is None or newest.relief is None:
            return False
        shift = register(before.relief, newest.relief, least_overlap=self.settings.least_overlap)
        if shift is None or abs(shift.along_mm) < max(_LEAST_MOTION_MM, 3 * shift.sigma_mm):
            return False
        forward = 1 if newest.encoder_mm is None or newest.encoder_mm >= (before.encoder_mm or 0.0) else -1
        self._direction = self._direction or forward * (1 if shift.along_mm > 0 else -1)
        if newest.encoder_mm is None and newest.clock > before.clock:
            self.motion.speed = self._direction * shift.along_mm / (newest.clock - before.clock)
        return True

    def _impatient(self) -> list[FlowRecord]:
        """What to do with the frame that waits longest for a first motion, where many do."""
        if len(self._waiting) <= _PATIENCE:
            return []
        oldest = self._waiting.pop(0)
        if oldest.encoder_mm is None:
            self._strips.add(self._cutter.make_unplaced_strip(oldest))
            return self._finished()
        # an empty or a standing belt: either direction gives the same until the material tells which it is
        self._direction, self._assumed = 1, True
        out = self._take(oldest)
        for one in self._waiting:
            out += self._take(one)
        self._waiting = []
        return out

    def _take(self, seen: PushedFrame) -> list[FlowRecord]:
        """BeltPosition a frame, lay it over the others, cut its strip."""
        before = self.motion.last
        shift = self._shift(seen)
        observation = MotionObservation(
            seen.clock,
            seen.encoder_mm,
            None if shift is None else self._direction * shift.along_mm,
            0.0 if shift is None else shift.sigma_mm,
        )
        place = None if before is None and seen.depth is None else self.motion.locate(observation)
        if place is None:
            self._strips.add(self._cutter.make_unplaced_strip(seen))
            return self._finished()
        if self._watch_step is not None:
            self._watch_step(Step(seen.frame, place, shift))
        if seen.depth is not None:
            blur = place.sigma_mm if place.source == "speed" else 0.0
            layer = self.ground.layer(seen.depth, place.position_mm, self._direction, blur)
            self._buffer.add(layer, place.position_mm)
            self._move_key(seen, place)
        window_mm = self._ends(self.ground.window_mm)
        self._strips.add(self._cutter.cut(seen, place, before, window_mm))
        seen_until = place.position_mm + self._ends(self.ground.seen_mm)[0]
        for rows in self._buffer.fuse_until(seen_until):
            self._profile.add(rows)
        return self._finished(seen_until)

    def _shift(self, seen: PushedFrame) -> Shift | None:
        """BeltMotion since the key frame; where the direction was only assumed, the material may turn it."""
        if self._key_relief is None or seen.relief is None:
            return None
        expected = self.motion.predict_mm(seen.clock, seen.encoder_mm)
        low, high = self.ground.seen_mm
        reach = (1 - self.settings.least_overlap) * (high - low)
        apart = seen.encoder_mm is not None and (1 - MAX_DISAGREEMENT) * abs(expected or 0.0) > reach
        near = None if expected is None or self._assumed or apart else self._direction * expected
        shift = register(
            self._key_relief, seen.relief, least_overlap=self.settings.least_overlap, near_mm=near
        )
        if shift is None:
            return None
        if self._assumed and not apart and abs(shift.along_mm) > _LEAST_MOTION_MM:
            self._assumed = False
            if self._direction * shift.along_mm < 0:
                self._direction = -self._direction
                self._buffer.clear()
        self._weigh(shift, seen, apart)
        # by the encoder the views have nothing in common: then what looks alike is other material
        return None if apart else shift

    def _weigh(self, shift: Shift, seen: PushedFrame, apart: bool) -> None:
        """Count the motion since the key frame as evidence, beside what the raw encoder says of it."""
        key = self.motion.key
        step = None
        if key is not None and key.encoder_mm is not None and seen.encoder_mm is not None:
            step = seen.encoder_mm - key.encoder_mm
        self.evidence.add(shift, self._direction, step, apart=apart)

    def _move_key(self, seen: PushedFrame, place: BeltPosition) -> None:
        """A new key frame once the belt has moved, unless this one tells nothing and the old one still may."""
        key = self.motion.key
        moved = abs(place.position_mm - key.position_mm) if key is not None else np.inf
        low, high = self.ground.seen_mm
        has_load = seen.relief is not None and seen.relief.has_load
        kept = self._key_relief is not None and self._key_relief.has_load
        lost = moved > (1 - self.settings.least_overlap) * (high - low)
        if self._key_relief is None or (moved >= self._buffer.step_mm and (has_load or not kept)) or lost:
            self.motion.move_key()
            self._key_relief = seen.relief

    def _ends(self, range_mm: tuple[float, float]) -> tuple[float, float]:
        """Ends of a range of y as belt coordinates of a frame at position 0, the older end first."""
        low, high = sorted(-self._direction * y for y in range_mm)
        return low, high

    def _finished(self, seen_until_mm: float = -np.inf) -> list[FlowRecord]:
        """Records whose strips are complete; on a gap too long to bridge nothing is waited for."""
        end = self._profile.end_mm
        until = -np.inf if end is None else end - self.ground.cell_mm
        begins = min(seen_until_mm, self._buffer.open_mm)
        if end is not None and begins - end > self.settings.bridge_mm:
            until = begins
        out = self._strips.pop_finished(self._profile, until)
        if self._strips.first is not None and np.isfinite(self._strips.first.start_mm):
            self._profile.discard_before(self._strips.first.start_mm)
        return out
