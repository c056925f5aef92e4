"""The belt's position at each frame, by registration with a key frame, and the encoder's agreement with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.flow.foreign_objects import ForeignObjectCheck
from beltscape.measure.flow.fusion.empty_belt_reference import EmptyBeltReference
from beltscape.measure.flow.motion.belt_motion import (
    MAX_DISAGREEMENT,
    BeltMotion,
    BeltPosition,
    MotionObservation,
)
from beltscape.measure.flow.motion.encoder_check import LEAST_MM, Contradiction, EncoderCheck, Interval
from beltscape.measure.flow.motion.encoder_finding import make_encoder_finding, make_stall_finding
from beltscape.measure.flow.motion.encoder_scale import EncoderScale
from beltscape.measure.flow.motion.first_motion import FirstMotion
from beltscape.measure.flow.motion.key_frame import KeyFrame
from beltscape.measure.flow.motion.location import Location, MotionPrediction, Observation
from beltscape.measure.flow.motion.motion_evidence import MotionEvidence
from beltscape.measure.flow.motion.plausibility import (
    LEAST_SUPPORT,
    differ,
    is_belt_surface,
    is_certain,
    is_certain_apart,
    is_repeated,
)
from beltscape.measure.flow.motion.pushed_frame import PushedFrame
from beltscape.measure.flow.motion.readings import ReadingCheck, RollBack
from beltscape.measure.flow.motion.recount import LocatedFrame, ProvenMotion, UnconfirmedTravel
from beltscape.measure.flow.motion.registration.high_pass import HighPassHeights, compute_free_mm
from beltscape.measure.flow.motion.registration.shift import Shift, register
from beltscape.measure.flow.settings import FlowSettings
_SIGMAS = 4.0
"""A motion counts if it exceeds this many σ of its registration, as in `encoder_check`."""
_STALL_STEPS = 4.0
"""An encoder certainly counts on if its step is longer than this multiple of what counts as none. Chosen."""


class MotionTracker:
    """Locates frames one after the other."""

    def __init__(
        self,
        reference: EmptyBeltReference,
        settings: FlowSettings,
        key_step_mm: float,
        foreign: ForeignObjectCheck,
    ) -> None:
        """The key frame is replaced once the belt has moved by ``key_step_mm``; ``foreign`` finds what is no load."""
        self.motion = BeltMotion()
        self.evidence = MotionEvidence()
        self.check = EncoderCheck(settings.encoder_tolerance)
        self.direction = {None: 0, "+y": 1, "-y": -1}[settings.direction]
        """+1 towards +y, -1 towards -y, 0 if not known yet."""
        self.is_assumed = False  # whether the direction is only assumed
        self._reference, self._settings, self._key_step_mm = reference, settings, key_step_mm
        low, high = reference.seen_mm
        self._reach_mm = (1 - settings.least_overlap) * (high - low)
        """Longest motion between two frames that can be registered."""
        self._key = KeyFrame(settings.least_overlap)
        self._open: tuple[Interval, bool] | None = None
        """The interval from the key frame to the last one, and whether encoder and material agree on it."""
        self._speed_by_match: float | None = None
        """Speed by the last registration, mm per unit of the clock."""
        self._first = FirstMotion(settings.least_overlap)
        self._travel = UnconfirmedTravel()
        self._readings = ReadingCheck()
        self._rolled_back, self._foreign = RollBack(), foreign
        self._shown_mm: float | None = None
        """Position of the belt that the images of the last registered frame showed."""

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
        along, before = self._first.along_mm, waiting[-2]
        self.direction = self.direction or (1 if along > 0 else -1)
        contradiction = self._first.contradiction
        if contradiction is not None:
            self.check.distrust(contradiction)
        if (newest.encoder_mm is None or contradiction is not None) and newest.clock > before.clock:
            self.motion.speed = self.direction * along / (newest.clock - before.clock)
        return True

    def may_roll_back(self, waiting: Sequence[PushedFrame]) -> bool:
        """Return whether the encoder's readings of waiting frames fall by no more than a belt rolls back."""
        rolled_back = RollBack()
        for one in waiting:
            rolled_back.add(one.encoder_mm)
        return rolled_back.is_running_back and not rolled_back.is_too_far

    def assume_direction(self, waiting: Sequence[PushedFrame]) -> None:
        """Assume a direction until the material shows one; both are equivalent for a belt that is empty or stands."""
        if self.direction:
            return
        self.direction, self.is_assumed = 1, True
        for one in waiting:
            self._rolled_back.add(one.encoder_mm)

    def locate(self, frame: PushedFrame) -> Location:
        """Return the frame's position from the best observation, and compare the encoder with the material."""
        was_assumed, direction = self.is_assumed, self.direction
        self._open = None
        self._rolled_back.add(frame.encoder_mm)
        found = self._readings.find_contradiction(frame, self.motion, self._travel.confirmed)
        by_reading = found if self.check.is_trusted else None
        observed = self._observe(frame, trusted=self.check.is_trusted and by_reading is None)
        shift = observed.shift
        agrees = self._open is not None and self._open[1]
        contradiction = observed.contradiction or (None if agrees else by_reading)
        relocated: list[LocatedFrame] = []
        if contradiction is not None and contradiction.kind == "resumed":
            relocated = self._resume(frame)
        elif shift is not None and (contradiction is not None or not self.check.is_trusted):
            relocated = self._relocate(frame, shift, contradiction)
        if contradiction is not None:
            self.check.distrust(contradiction)
        elif shift is None:
            self._compare_with_speed(frame)
        before, place, finding = self.motion.last, self._place(frame, observed), None
        if place is not None:
            is_confirmed = shift is not None and (agrees or not self.check.is_trusted)
            located = LocatedFrame(frame.number, frame.frame, place)
            self._travel.add(located, self.motion.speed, is_confirmed=is_confirmed)
            if observed.is_stalled:
                step = (place.encoder_mm or 0.0) - (0.0 if before is None else before.encoder_mm or 0.0)
                finding = make_stall_finding(step, self.check.tolerance)
            elif frame.encoder_mm is not None or not self.check.is_trusted:
                finding = make_encoder_finding(self.check, before, place)
        has_turned = was_assumed and self.direction != direction
        return Location(
            place,
            shift,
            self.check.is_trusted,
            contradiction,
            finding,
            has_turned,
            observed.is_stalled,
            tuple(relocated),
        )

    def _place(self, frame: PushedFrame, observed: Observation) -> BeltPosition | None:
        """Return the frame's position from the best observation; None if unknown."""
        motion, trusted, shift = self.motion, self.check.is_trusted, observed.shift
        if observed.is_uncertain and not trusted:
            motion.observe_movement(frame.clock)
        if motion.last is None and frame.depth is None:
            return None
        place = motion.locate(
            MotionObservation(
                frame.clock,
                frame.encoder_mm,
                None if shift is None else self.direction * shift.along_mm,
                0.0 if shift is None else shift.sigma_mm,
                uses_encoder=trusted and not (observed.is_uncertain and motion.speed is not None),
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

    def _compute_elapsed(self, frame: PushedFrame) -> float:
        """Return the time since the key frame; 0 without one."""
        return frame.clock - (self.motion.key or frame).clock

    def update_key(self, frame: PushedFrame, location: Location) -> None:
        """Make the frame the key frame once the belt has moved, unless only the old one has load and overlaps.

        A frame with load that does not match the key frame replaces it: else a key frame without common load would
        remain for as long as an encoder stands still, whatever passes.
        """
        key, place = self.motion.key, location.place
        moved = abs(place.position_mm - key.position_mm) if key is not None and place is not None else np.inf
        has_load = frame.high_pass is not None and frame.high_pass.has_load
        is_out_of_view = moved > self._reach_mm
        is_unmatched = location.shift is None and has_load and not location.is_stalled
        is_due = moved >= self._key_step_mm and not location.is_stalled and (has_load or not self._key.has_load)
        if self._key.heights is None or is_due or is_unmatched or is_out_of_view:
            self.motion.move_key()
            self._key.replace(frame)
            self._shown_mm = None if place is None else place.position_mm
            self._close_interval()

    def _close_interval(self) -> None:
        """Add the interval that ends with a new key frame; if the encoder is trusted again, begin its scale anew."""
        if self._open is not None and self.check.close(self._open[0], agrees=self._open[1]):
            self.motion.scale = EncoderScale()

    def _observe(self, frame: PushedFrame, *, trusted: bool) -> Observation:
        """Observe the motion since the key frame; ``trusted``: the encoder may be used to predict it."""
        key, motion = self._key, self.motion
        if key.heights is None or frame.high_pass is None:
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
        shift = key.register(frame.high_pass, None if near is None else self.direction * near)
        by_encoder = trusted and shift is not None and not shift.clear
        if shift is None and trusted and not self.is_assumed and differ(by_speed, expected):
            shift, by_encoder = key.register(frame.high_pass, self.direction * (by_speed or 0.0)), False
        if trusted and shift is not None and self._is_stalled(frame, shift):
            self.evidence.add(shift, self.direction, self._encoder_step_mm(frame), apart=is_beyond)
            return Observation(is_stalled=True)
        if near is not None and not apart and (shift is None or differ(self.direction * shift.along_mm, near)):
            without = self._register_without_foreign(frame.high_pass, near)
            shift, by_encoder = (shift, by_encoder) if without is None else (without, False)
        self._turn(frame, shift, apart=apart)
        if shift is not None:
            self.evidence.add(shift, self.direction, self._encoder_step_mm(frame), apart=is_beyond)
            if not self._is_credible(frame, shift, expected, by_speed, apart=apart):
                shift = None
        if shift is not None:
            key.reset_unmatched()
            contradiction = None if by_encoder else self._compare(frame, shift)
            if trusted and contradiction is not None and contradiction.kind == "standing":
                self._open = None
                return Observation(is_stalled=True)
            return Observation(shift, contradiction)
        # not where the encoder puts it; while it is not trusted: not where a standstill puts it
        if apart or near is None or not key.is_unmatched(frame, self.direction * near if trusted else 0.0):
            return Observation()
        if not trusted or not key.count_unmatched():
            return Observation(is_uncertain=True)
        first = 1 + min(key.number, self.check.agreed)
        return Observation(None, Contradiction("unmatched", first, np.nan, np.nan), is_uncertain=True)

    def _is_stalled(self, frame: PushedFrame, shift: Shift) -> bool:
        """Return whether the material stands where the frame before showed it, although the encoder counts on."""
        key, last, before = self.motion.key, self.motion.last, self._shown_mm
        if key is None or last is None or self._key.heights is None or frame.high_pass is None:
            return False
        self._shown_mm = key.position_mm + self.direction * shift.along_mm
        if before is None or frame.encoder_mm is None or last.encoder_mm is None or self.is_assumed:
            return False
        least = LEAST_MM + _SIGMAS * shift.sigma_mm
        counts = frame.encoder_mm - last.encoder_mm > _STALL_STEPS * least
        is_still = abs(self._shown_mm - before) <= least
        return counts and is_still and is_repeated(self._key.heights, frame.high_pass, shift)

    def _register_without_foreign(self, heights: HighPassHeights, near_mm: float) -> Shift | None:
        """Return the registration without what would be foreign at the prediction, if it confirms that; else None."""
        key = self.motion.key
        if key is None or self._key.heights is None:
            return None
        noise_mm = self._reference.belt.noise_mm
        here, earlier = self._foreign.preview(
            key.position_mm + near_mm, self.direction, heights.surface_mm
        )
        gone = earlier.get(self._key.number, np.zeros_like(here))
        if not (here.any() or gone.any()):
            return None
        shift = register(
            self._key.heights.leave_out(gone, noise_mm),
            heights.leave_out(here, noise_mm),
            least_overlap=self._settings.least_overlap,
            near_mm=self.direction * near_mm,
        )
        is_confirmed = shift is not None and not differ(self.direction * shift.along_mm, near_mm)
        return shift if is_confirmed and shift.support >= LEAST_SUPPORT else None

    def leave_out(self, number: int, cells: NDArray[np.bool_]) -> None:
        """Register later frames without cells (Ny, Nx) of frame ``number`` that are no load."""
        self._key.leave_out(number, cells, self._reference.belt.noise_mm)

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
        key = self._key.heights
        if key is None or self.motion.key is None or frame.high_pass is None:
            return True
        along, elapsed = self.direction * shift.along_mm, self._compute_elapsed(frame)
        speed_before, self._speed_by_match = self._speed_by_match, along / elapsed if elapsed > 0 else None
        if apart:
            # by the encoder the views do not overlap: then a similar surface is other material
            return is_certain_apart(shift, along, by_speed_mm, self.evidence)
        if is_belt_surface(key, frame.high_pass, along, expected_mm):
            return False
        step = self._encoder_step_mm(frame)
        if self.check.is_trusted and (step is None or not differ(along, step / self.motion.scale.ratio)):
            return True
        by_speeds = (by_speed_mm, self._travel.predict_motion_mm(elapsed))
        return is_certain(shift, along, by_speeds, speed_before, elapsed)

    def _turn(self, frame: PushedFrame, shift: Shift | None, *, apart: bool) -> None:
        """Replace an assumed direction by that of the material's motion.

        While encoder and material run back together, the direction is that of a belt that rolls back, until this
        takes longer than a belt does: then the encoder counts in reverse.
        """
        if shift is None or not self.is_assumed or apart or abs(shift.along_mm) <= LEAST_MM:
            return
        along, step = (1 if shift.along_mm > 0 else -1), self._encoder_step_mm(frame)
        if step is None or step >= -LEAST_MM:
            self.is_assumed, self.direction = False, along
            return
        self.is_assumed = not self._rolled_back.is_too_far
        self.direction = -along if self.is_assumed else along

    def _encoder_step_mm(self, frame: PushedFrame) -> float | None:
        """Return the raw encoder's step since the key frame; None without an encoder."""
        key = self.motion.key
        if key is None or key.encoder_mm is None or frame.encoder_mm is None:
            return None
        return frame.encoder_mm - key.encoder_mm

    def _compare(self, frame: PushedFrame, shift: Shift) -> Contradiction | None:
        """Compare the encoder's step since the key frame with the material's."""
        step = self._encoder_step_mm(frame)
        if step is None or self.is_assumed or shift.support < LEAST_SUPPORT:
            return None
        self._key.add_match(shift.score)
        moved_mm = self.direction * shift.along_mm
        interval = Interval(step, moved_mm, shift.sigma_mm**2, self._key.number, shift.common_mm)
        found = self.check.find_contradiction(interval, frame.number, self.motion.speed or 0.0)
        self._open = interval, found is None
        return found
