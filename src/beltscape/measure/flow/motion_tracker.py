"""The belt's position at each frame, by registration with a key frame, and the encoder's agreement with it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.findings import worst_effect
from beltscape.measure.flow.fusion.empty_belt_reference import EmptyBeltReference
from beltscape.measure.flow.motion.belt_motion import (
    MAX_DISAGREEMENT,
    BeltMotion,
    BeltPosition,
    MotionObservation,
)
from beltscape.measure.flow.motion.encoder_check import LEAST_MM, Contradiction, EncoderCheck, Interval
from beltscape.measure.flow.motion.encoder_finding import make_encoder_finding
from beltscape.measure.flow.motion.encoder_scale import EncoderScale
from beltscape.measure.flow.motion.high_pass import HighPassHeights, compute_high_pass
from beltscape.measure.flow.motion.location import Location, Observation
from beltscape.measure.flow.motion.motion_evidence import MotionEvidence
from beltscape.measure.flow.motion.plausibility import (
    LEAST_SUPPORT,
    differ,
    is_belt_surface,
    is_certain,
    is_certain_apart,
    is_confirmed,
    is_jump,
    is_unmatched,
)
from beltscape.measure.flow.motion.prediction import MotionPrediction
from beltscape.measure.flow.motion.registration import Shift, register
from beltscape.measure.flow.pushed_frame import PushedFrame
from beltscape.measure.flow.settings import FlowSettings

_COARSE_CELLS = 2
"""Cells of the registration are coarser by this factor."""
_LEAST_MOTION_MM = 2.0
"""A shorter motion does not determine the direction."""
_USUAL_SCORES = 16
"""Number of latest correlations that are kept as the usual ones."""
_LEAST_UNMATCHED = 2
"""Number of frames without a match after which the encoder's prediction is wrong; one frame may be bad itself."""


class MotionTracker:
    """Locates frames one after the other."""

    def __init__(self, reference: EmptyBeltReference, settings: FlowSettings, key_step_mm: float) -> None:
        """The key frame is replaced once the belt has moved by ``key_step_mm``."""
        self.motion = BeltMotion()
        self.evidence = MotionEvidence()
        self.check = EncoderCheck(settings.encoder_tolerance)
        given = settings.direction
        self.direction = 0 if given is None else 1 if given == "+y" else -1
        """+1 towards +y, -1 towards -y, 0 if not known yet."""
        self.is_assumed = False  # whether the direction is only assumed
        self._reference, self._settings, self._key_step_mm = reference, settings, key_step_mm
        low, high = reference.seen_mm
        self._reach_mm = (1 - settings.least_overlap) * (high - low)
        """Longest motion between two frames that can be registered."""
        self._key: HighPassHeights | None = None
        self._key_number = 0
        self._open: tuple[Interval, bool] | None = None
        """The interval from the key frame to the last one, and whether encoder and material agree on it."""
        self._scores: deque[float] = deque(maxlen=_USUAL_SCORES)
        self._unmatched = 0
        self._speed_by_match: float | None = None
        """Speed by the last registration, mm per unit of the clock."""
        self._first_mm = float("nan")  # motion of the pair of frames before, until the first motion is known
        self._last_reading: BeltPosition | None = None
        """The last position with an encoder reading."""

    @property
    def prediction(self) -> MotionPrediction | None:
        """Return the prediction of the motion after the last frame; None if unknown."""
        motion = self.motion
        if motion.last is None or not self.direction:
            return None
        along = self.direction * self._reference.belt.belt_from_core.rotation[1]
        return MotionPrediction(
            along,
            motion.scale.ratio,
            motion.speed,
            uses_encoder=self.check.is_trusted or motion.speed is None,
        )

    def filter(self, depth: DepthMap | None) -> HighPassHeights | None:
        """Return the high-pass heights of a depth map."""
        if depth is None:
            return None
        height, cell_mm = (
            self._reference.coarse(depth, _COARSE_CELLS),
            _COARSE_CELLS * self._reference.cell_mm,
        )
        return compute_high_pass(height, cell_mm, self._reference.belt.noise_mm)

    def can_locate(self, waiting: Sequence[PushedFrame]) -> bool:
        """Return whether frames can be placed: by a known motion, by an encoder, or by a first motion found now."""
        newest = waiting[-1]
        if self.motion.key is not None or (self.direction and newest.encoder_mm is not None):
            return True
        before = next((one for one in waiting[-2::-1] if one.high_pass is not None), None)
        if before is None or before.high_pass is None or newest.high_pass is None:
            return False
        shift = register(before.high_pass, newest.high_pass, least_overlap=self._settings.least_overlap)
        if shift is None or abs(shift.along_mm) < max(_LEAST_MOTION_MM, 3 * shift.sigma_mm):
            return False
        if newest.encoder_mm is not None and newest.encoder_mm < (before.encoder_mm or 0.0):
            return False  # the belt rolls back, or the encoder counts in reverse: a longer motion decides
        earlier, self._first_mm = self._first_mm, shift.along_mm
        if not is_confirmed(shift.along_mm, newest.encoder_mm, before.encoder_mm, earlier):
            return False
        self.direction = self.direction or (1 if shift.along_mm > 0 else -1)
        if newest.encoder_mm is None and newest.clock > before.clock:
            self.motion.speed = self.direction * shift.along_mm / (newest.clock - before.clock)
        return True

    def locate(self, frame: PushedFrame) -> Location:
        """Return the frame's position from the best observation, and compare the encoder with the material."""
        was_assumed, direction = self.is_assumed, self.direction
        self._open = None
        jump = self._find_jump(frame) if self.check.is_trusted else None
        observed = self._observe(frame, trusted=self.check.is_trusted and jump is None)
        shift = observed.shift
        agrees = self._open is not None and self._open[1]
        contradiction = observed.contradiction or (None if agrees else jump)
        if contradiction is not None:
            self.check.distrust(contradiction)
        elif shift is None:
            self._count_jump_over(frame)
        before = self.motion.last
        observation = MotionObservation(
            frame.clock,
            frame.encoder_mm,
            None if shift is None else self.direction * shift.along_mm,
            0.0 if shift is None else shift.sigma_mm,
            uses_encoder=self.check.is_trusted
            and not (observed.is_doubtful and self.motion.speed is not None),
        )
        if observed.is_doubtful and not self.check.is_trusted:
            self.motion.observe_movement(frame.clock)
        place = None if before is None and frame.depth is None else self.motion.locate(observation)
        if place is not None and frame.encoder_mm is not None:
            self._last_reading = place
        has_turned = was_assumed and self.direction != direction
        finding = None
        if place is not None and not (frame.encoder_mm is None and self.check.is_trusted):
            finding = make_encoder_finding(self.check, before, place)
        return Location(place, shift, self.check.is_trusted, contradiction, finding, has_turned)

    def update_key(self, frame: PushedFrame, place: BeltPosition) -> None:
        """Make the frame the key frame once the belt has moved, unless only the old one has load and overlaps."""
        key = self.motion.key
        moved = abs(place.position_mm - key.position_mm) if key is not None else np.inf
        has_load = frame.high_pass is not None and frame.high_pass.has_load
        kept = self._key is not None and self._key.has_load
        is_out_of_view = moved > self._reach_mm
        if self._key is None or (moved >= self._key_step_mm and (has_load or not kept)) or is_out_of_view:
            self.motion.move_key()
            self._key, self._key_number = frame.high_pass, frame.number
            self._close_interval()

    def _close_interval(self) -> None:
        """Add the interval that ends with a new key frame; if the encoder is trusted again, begin its scale anew."""
        if self._open is not None and self.check.close(self._open[0], agrees=self._open[1]):
            self.motion.scale = EncoderScale()

    def _observe(self, frame: PushedFrame, *, trusted: bool) -> Observation:
        """Observe the motion since the key frame; ``trusted``: the encoder may be used to predict it."""
        key, motion = self._key, self.motion
        if key is None or frame.high_pass is None:
            return Observation()
        trusted = trusted and frame.encoder_mm is not None
        by_speed = motion.predict_from_speed_mm(frame.clock)
        expected = motion.predict_mm(frame.clock, frame.encoder_mm)
        is_beyond = (1 - MAX_DISAGREEMENT) * abs(self._encoder_step_mm(frame) or 0.0) > self._reach_mm
        apart = trusted and is_beyond
        if not trusted and by_speed is not None:
            expected = by_speed
        is_in_view = (1 - MAX_DISAGREEMENT) * abs(expected or 0.0) <= self._reach_mm
        near = expected if is_in_view and not self.is_assumed else None
        shift = self._register(frame.high_pass, near)
        by_encoder = trusted and shift is not None and not shift.clear
        if shift is None and trusted and not self.is_assumed and differ(by_speed, expected):
            shift, by_encoder = self._register(frame.high_pass, by_speed), False
        self._turn(shift, apart=apart)
        if shift is not None:
            self.evidence.add(shift, self.direction, self._encoder_step_mm(frame), apart=is_beyond)
            if not self._is_credible(frame, shift, expected, by_speed, apart=apart):
                shift = None
        if shift is not None:
            self._unmatched = 0
            return Observation(shift, None if by_encoder else self._compare(frame, shift))
        if apart or near is None or not self._is_unmatched(frame, near if trusted else None):
            return Observation()
        return Observation(None, self._contradict_unmatched() if trusted else None, is_doubtful=True)

    def _is_credible(
        self,
        frame: PushedFrame,
        shift: Shift,
        expected_mm: float | None,
        by_speed_mm: float | None,
        *,
        apart: bool,
    ) -> bool:
        """Return whether a registration is the material's motion and not a match by chance."""
        key, position = self._key, self.motion.key
        if key is None or position is None or frame.high_pass is None:
            return True
        along, elapsed = self.direction * shift.along_mm, frame.clock - position.clock
        speed_before, self._speed_by_match = self._speed_by_match, along / elapsed if elapsed > 0 else None
        if apart:
            # by the encoder the views do not overlap: then a similar surface is other material
            return is_certain_apart(shift, along, by_speed_mm, self.evidence)
        if is_belt_surface(key, frame.high_pass, along, expected_mm):
            return False
        step = self._encoder_step_mm(frame)
        if self.check.is_trusted and (step is None or not differ(along, step / self.motion.scale.ratio)):
            return True
        return is_certain(shift, along, by_speed_mm, speed_before, elapsed)

    def _register(self, high_pass: HighPassHeights, near_mm: float | None) -> Shift | None:
        """Return the motion of the material since the key frame; ``near_mm`` is the prediction along the travel."""
        assert self._key is not None
        near = None if near_mm is None else self.direction * near_mm
        return register(self._key, high_pass, least_overlap=self._settings.least_overlap, near_mm=near)

    def _turn(self, shift: Shift | None, *, apart: bool) -> None:
        """Replace an assumed direction by that of the material's motion."""
        if shift is None or not self.is_assumed or apart or abs(shift.along_mm) <= _LEAST_MOTION_MM:
            return
        self.is_assumed = False
        if self.direction * shift.along_mm < 0:
            self.direction = -self.direction

    def _encoder_step_mm(self, frame: PushedFrame) -> float | None:
        """Return the raw encoder's step since the key frame; None without an encoder."""
        key = self.motion.key
        if key is None or key.encoder_mm is None or frame.encoder_mm is None:
            return None
        return frame.encoder_mm - key.encoder_mm

    def _is_unmatched(self, frame: PushedFrame, near_mm: float | None) -> bool:
        """Return whether the material is not where the encoder puts it; None: not where a standstill puts it."""
        if self._key is None or frame.high_pass is None or worst_effect(frame.findings) != "none":
            return False
        return is_unmatched(
            self._key,
            frame.high_pass,
            self.direction * (near_mm or 0.0),
            least_overlap=self._settings.least_overlap,
            usual_scores=self._scores,
        )

    def _contradict_unmatched(self) -> Contradiction | None:
        self._unmatched += 1
        if self._unmatched < _LEAST_UNMATCHED:
            return None
        self._unmatched = 0
        return Contradiction("unmatched", self._key_number + 1, float("nan"), float("nan"))

    def _compare(self, frame: PushedFrame, shift: Shift) -> Contradiction | None:
        """Compare the encoder's step since the key frame with the material's."""
        step = self._encoder_step_mm(frame)
        if step is None or self.is_assumed or shift.support < LEAST_SUPPORT:
            return None
        self._scores.append(shift.score)
        interval = Interval(step, self.direction * shift.along_mm, shift.sigma_mm**2, self._key_number)
        found = self.check.find_contradiction(interval, frame.number, self.motion.speed or 0.0)
        self._open = interval, found is None
        return found

    def _find_jump(self, frame: PushedFrame) -> Contradiction | None:
        """Return the contradiction of a reading to which no belt can have moved since the last reading."""
        before, last = self._last_reading, self.motion.last
        if before is None or last is None or frame.encoder_mm is None:
            return None
        if not is_jump(before, last, self.motion.speed, frame.clock, frame.encoder_mm):
            return None
        return Contradiction("jump", frame.number, float("nan"), float("nan"))

    def _count_jump_over(self, frame: PushedFrame) -> None:
        """Count the agreement of the encoder with the last speed, where the material does not show the motion."""
        last, speed, found = self.motion.last, self.motion.speed, self.check.contradiction
        if found is None or found.kind not in ("jump", "unmatched") or last is None or speed is None:
            return
        if frame.encoder_mm is None or last.encoder_mm is None:
            return
        step, by_speed = frame.encoder_mm - last.encoder_mm, speed * (frame.clock - last.clock)
        agrees = abs(step - by_speed) <= MAX_DISAGREEMENT * abs(by_speed)
        if abs(by_speed) > LEAST_MM and agrees and self.check.count_agreement():
            self.motion.scale = EncoderScale()
