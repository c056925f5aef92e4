"""The belt's position at each frame, by registration with a key frame, and the encoder's agreement with it.

Before any frame has a position, the first motion of the material gives the direction and a check of the encoder.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltscape.core.findings import Finding
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.flow.belt_motion import BeltPosition, EncoderScale, MotionObservation
from beltscape.measure.flow.encoder_check import (
    LEAST_MM,
    Contradiction,
    make_contradiction,
    make_encoder_finding,
    make_stall_finding,
)
from beltscape.measure.flow.foreign_objects import ForeignObjectCheck
from beltscape.measure.flow.location import (
    LocatedFrame,
    Location,
    MaterialState,
    MotionPrediction,
    Observation,
    ProvenMotion,
    PushedFrame,
    Verdict,
    select_consequence,
)
from beltscape.measure.flow.material_observer import MaterialObserver
from beltscape.measure.flow.motion_evidence import LEAST_PAIRS
from beltscape.measure.flow.plausibility import ReadingCheck, are_consistent, is_confirmed, is_sudden
from beltscape.measure.flow.registration import Shift, compute_free_mm, register
from beltscape.measure.flow.settings import FlowSettings


class FirstMotion:
    """Registers the frames that wait for a first position, pair by pair."""

    def __init__(self, least_overlap: float) -> None:
        self._least_overlap = least_overlap
        self._motions: list[Shift] = []
        """The motions of consecutive pairs that the encoder does not confirm."""
        self.along_mm = float("nan")
        """The confirmed motion of the last pair along y."""
        self.is_contradicting = False
        """Whether the last pair's motion is known and the encoder does not confirm it."""
        self.contradiction: Contradiction | None = None
        """The contradiction of the encoder with several pairs that agree with each other."""

    def find(self, waiting: Sequence[PushedFrame]) -> bool:
        """Register the last two frames; return whether their motion is confirmed."""
        newest, self.is_contradicting = waiting[-1], False
        before = next((one for one in waiting[-2::-1] if one.high_pass is not None), None)
        if before is None or before.high_pass is None or newest.high_pass is None:
            return False
        shift = register(before.high_pass, newest.high_pass, least_overlap=self._least_overlap)
        if shift is None or abs(shift.along_mm) < max(LEAST_MM, 3 * shift.sigma_mm):
            return False
        if newest.encoder_mm is not None and newest.encoder_mm < (before.encoder_mm or 0.0):
            return False  # the belt rolls back, or the encoder counts in reverse: a longer motion decides
        self.along_mm = shift.along_mm
        if is_confirmed(shift.along_mm, newest.encoder_mm, before.encoder_mm):
            return True
        self.is_contradicting = True
        self._motions = [*self._motions, shift][-LEAST_PAIRS:]
        if len(self._motions) < LEAST_PAIRS or not are_consistent(self._motions):
            return False
        self.contradiction = _contradict(before, newest, shift)
        return True


def _contradict(before: PushedFrame, newest: PushedFrame, shift: Shift) -> Contradiction:
    """Return the contradiction from the first frame on."""
    step = (newest.encoder_mm or 0.0) - (before.encoder_mm or 0.0)
    return make_contradiction(step, abs(shift.along_mm), shift.sigma_mm**2, first=0, intervals=LEAST_PAIRS)


class MotionTracker(MaterialObserver):
    """Locates frames one after the other."""

    def __init__(
        self,
        reference: EmptyBeltReference,
        settings: FlowSettings,
        key_step_mm: float,
        foreign: ForeignObjectCheck,
    ) -> None:
        """The key frame is replaced once the belt has moved by ``key_step_mm``; ``foreign`` finds what is no load."""
        super().__init__(reference, settings, foreign)
        self._key_step_mm = key_step_mm
        self._first = FirstMotion(settings.least_overlap)
        self._readings = ReadingCheck()
        self._state: MaterialState = "unknown"
        """What the last frame's material shows."""
        self._undisputed_speed: float | None = None
        """Speed before the encoder's changed faster than a belt's; None once material or the old speed is back."""

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

    @property
    def follows_encoder(self) -> bool:
        """Return whether the last frame lies where the encoder puts it, and its material does not contradict that."""
        last = self.motion.last
        has_reading = last is not None and last.encoder_mm is not None
        return has_reading and self.check.is_trusted and self._state in ("unknown", "matched")

    def continue_motion(self, motion: MotionPrediction) -> None:
        """Begin with the speed and the direction that another tracker of the same belt found."""
        self.motion.speed = motion.speed
        is_forward = motion.along @ self._reference.belt.belt_from_core.rotation[1] > 0
        self.direction = self.direction or (1 if is_forward else -1)

    def can_locate(self, waiting: Sequence[PushedFrame]) -> bool:
        """Return whether frames can be placed: by a known motion, by an encoder, or by a first motion found now."""
        newest = waiting[-1]
        if self.motion.key is not None or (self.direction and self.motion.speed is not None):
            return True
        is_known = bool(self.direction) and newest.encoder_mm is not None
        if is_known and len(waiting) == 1:
            return newest.high_pass is None or not newest.high_pass.has_load
        if not self._first.find(waiting):
            return is_known and not self._first.is_contradicting
        self._begin_with_first_motion(newest, waiting[-2])
        return True

    def _begin_with_first_motion(self, newest: PushedFrame, before: PushedFrame) -> None:
        """Take direction and speed from the first motion; distrust an encoder that contradicts it."""
        along, contradiction = self._first.along_mm, self._first.contradiction
        self.direction = self.direction or (1 if along > 0 else -1)
        if contradiction is not None:
            self.check.distrust(contradiction)
        if (newest.encoder_mm is None or contradiction is not None) and newest.clock > before.clock:
            self.motion.speed = self.direction * along / (newest.clock - before.clock)

    def locate(self, frame: PushedFrame) -> Location:
        """Return the frame's position from the best observation, and compare the encoder with the material."""
        was_assumed, direction = self.is_assumed, self.direction
        observed, contradiction = self._observe_and_compare(frame)
        self._state = observed.state
        relocated = self._apply(frame, observed, contradiction)
        self._check_speed(frame, observed)
        before, place, finding = self.motion.last, self._place(frame, observed), None
        if place is not None:
            is_confirmed = observed.state == "matched" and (self._agrees or not self.check.is_trusted)
            located = LocatedFrame(frame.number, frame.frame, place)
            self._travel.add(located, self.motion.speed, is_confirmed=is_confirmed)
            finding = self._make_finding(frame, observed, before, place)
        return Location(
            place,
            observed.shift,
            self.check.is_trusted,
            contradiction,
            finding,
            has_turned=was_assumed and self.direction != direction,
            is_sudden=self._undisputed_speed is not None,
            is_stalled=observed.state == "standing",
            relocated=tuple(relocated),
        )

    @property
    def _agrees(self) -> bool:
        """Whether encoder and material agree since the key frame."""
        return self._open is not None and self._open[1]

    def _observe_and_compare(self, frame: PushedFrame) -> tuple[Observation, Contradiction | None]:
        """Return the observation, and what contradicts the encoder: the material, else its own readings."""
        self._open = None
        self._rolled_back.add(frame.encoder_mm)
        found = self._readings.find_contradiction(frame, self.motion, self._travel.confirmed)
        by_reading = found if self.check.is_trusted else None
        is_trusted = self.check.is_trusted and by_reading is None
        observed = self._observe(frame, frame.encoder_mm if is_trusted else None)
        return observed, observed.contradiction or (None if self._agrees else by_reading)

    def _apply(
        self, frame: PushedFrame, observed: Observation, contradiction: Contradiction | None
    ) -> list[LocatedFrame]:
        """Apply an observation's consequences; return the earlier frames that it moves."""
        consequence = select_consequence(observed.state, self._assess_encoder(contradiction))
        relocated: list[LocatedFrame] = []
        if consequence.earlier == "distributed":
            relocated = self._resume(frame)
        elif consequence.earlier == "relocated" and observed.shift is not None:
            relocated = self._relocate(frame, observed.shift, contradiction)
        if consequence.encoder == "distrusted" and contradiction is not None:
            self.check.distrust(contradiction)
        elif consequence.encoder == "compared":
            self._compare_with_speed(frame)
        return relocated

    def _assess_encoder(self, contradiction: Contradiction | None) -> Verdict:
        """Return what is known of the encoder."""
        if contradiction is not None:
            return "resumed" if contradiction.kind == "resumed" else "contradicted"
        return "trusted" if self.check.is_trusted else "distrusted"

    def _make_finding(
        self, frame: PushedFrame, observed: Observation, before: BeltPosition | None, place: BeltPosition
    ) -> Finding | None:
        """Return the finding about the encoder; None without one that was ever believed."""
        if observed.state == "standing":
            step = (place.encoder_mm or 0.0) - (0.0 if before is None else before.encoder_mm or 0.0)
            return make_stall_finding(step, self.check.tolerance)
        if frame.encoder_mm is not None or not self.check.is_trusted:
            return make_encoder_finding(self.check, before, place)
        return None

    def _check_speed(self, frame: PushedFrame, observed: Observation) -> None:
        """Note a change of the encoder's speed that only material can confirm, until the speed returns."""
        last = self.motion.last
        if observed.shift is not None:
            self._undisputed_speed = None
        elif last is not None and last.encoder_mm is not None and frame.encoder_mm is not None:
            before = self.motion.speed if self._undisputed_speed is None else self._undisputed_speed
            step, elapsed = frame.encoder_mm - last.encoder_mm, frame.clock - last.clock
            self._undisputed_speed = before if is_sudden(before, step, elapsed) else None

    def _place(self, frame: PushedFrame, observed: Observation) -> BeltPosition | None:
        """Return the frame's position from the best observation; None if unknown."""
        motion, trusted, shift = self.motion, self.check.is_trusted, observed.shift
        if observed.state == "elsewhere" and not trusted:
            motion.observe_movement(frame.clock)
        if motion.last is None and frame.depth is None:
            return None
        place = motion.locate(
            MotionObservation(
                frame.clock,
                frame.encoder_mm,
                None if shift is None else self.direction * shift.along_mm,
                0.0 if shift is None else shift.sigma_mm,
                uses_encoder=trusted and not (observed.state == "elsewhere" and motion.speed is not None),
                encoder_ratio=np.nan if trusted else self.check.constant_ratio,
            )
        )
        self._readings.add(frame, place, motion.speed)
        return place

    def _relocate(
        self, frame: PushedFrame, shift: Shift, contradiction: Contradiction | None
    ) -> list[LocatedFrame]:
        """Move key and last frame, and return the frames since the last agreement with their new positions."""
        key, elapsed = self.motion.key, self._compute_elapsed(frame)
        if key is None or self._key.heights is None or elapsed <= 0:
            return []
        proven = ProvenMotion(
            LocatedFrame(self._key.number, "", key),
            self.direction * shift.along_mm / elapsed,
            self.check.constant_ratio if contradiction is None else 1 + contradiction.value,
            compute_free_mm(self._key.heights, self.direction),
        )
        relocated = self._travel.relocate(proven)
        at_key = next((one.place for one in relocated if one.number == self._key.number), None)
        if at_key is None:
            return []
        self.motion.move(at_key.position_mm, relocated[-1].place.position_mm)
        return relocated

    def _compare_with_speed(self, frame: PushedFrame) -> None:
        """Count the agreement of the encoder with a constant speed, where the material does not show the motion."""
        step = self._readings.find_steady_step(frame, self.motion, self.check.contradiction)
        if step is not None and frame.encoder_mm is not None and self.check.count_agreement():
            self.motion.restart_scale(frame.encoder_mm - step)

    def _resume(self, frame: PushedFrame) -> list[LocatedFrame]:
        """Distribute the travel of an encoder that stood still and is now ahead over the frames since then."""
        found, key, last = self._readings.find_resumption(frame), self.motion.key, self.motion.last
        if found is None or key is None or last is None:
            return []
        start, self.motion.speed = found.start, found.speed
        relocated = self._travel.distribute(found.number, start, found.speed)
        key = next((one.place for one in relocated if one.number == self._key.number), key)
        self.motion.move(key.position_mm, start.position_mm + found.speed * (last.clock - start.clock))
        return relocated

    def update_key(self, frame: PushedFrame, location: Location) -> None:
        """Make the frame the key frame once the belt has moved, unless only the old one has load and overlaps.

        A frame with load that does not match the key frame replaces it: else a key frame without common load would
        remain for as long as an encoder stands still, whatever passes.
        """
        key, place = self.motion.key, location.place
        moved = abs(place.position_mm - key.position_mm) if key is not None and place is not None else np.inf
        has_load = frame.high_pass is not None and frame.high_pass.has_load
        is_out_of_view = moved > self.reach_mm
        is_unmatched = location.shift is None and has_load and not location.is_stalled
        is_due = (
            moved >= self._key_step_mm and not location.is_stalled and (has_load or not self._key.has_load)
        )
        if self._key.heights is None or is_due or is_unmatched or is_out_of_view:
            self.motion.move_key()
            self._key.replace(frame)
            self._shown_mm = None if place is None else place.position_mm
            self._close_interval()

    def _close_interval(self) -> None:
        """Add the interval that ends with a new key frame; if the encoder is trusted again, begin its scale anew."""
        if self._open is not None and self.check.close(self._open[0], agrees=self._open[1]):
            self.motion.scale = EncoderScale()
