"""The check of the encoder's readings by themselves: jumps, silence, and a standstill while the belt went on."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.measure.flow.motion.belt_motion import MAX_DISAGREEMENT, BeltMotion, BeltPosition
from beltscape.measure.flow.motion.encoder_check import LEAST_MM, Contradiction, Kind
from beltscape.measure.flow.motion.plausibility import is_jump
from beltscape.measure.flow.motion.pushed_frame import PushedFrame

_NAN = float("nan")
_ROLL_BACK_MM = 500.0
"""A loaded belt that stops may roll back this far, as in `sources.encoder.readings.count`."""
_LEAST_MISSING = 2
"""Frames without a reading from which the encoder is silent; one reading may be lost on its way."""
_WITHOUT_MATERIAL: tuple[Kind, ...] = ("jump", "unmatched", "silent", "resumed")
"""Contradictions after which the encoder is trusted again by the belt's speed, where no material shows the motion."""


@dataclass(frozen=True, slots=True)
class Resumption:
    """The motion of a belt that went on while the encoder stood still."""

    number: int
    """Number of the frame from which on the reading stood still."""
    start: BeltPosition
    """Position in that frame."""
    speed: float
    """mm per unit of the clock."""


class RollBack:
    """Follows how far the readings are behind the farthest one."""

    def __init__(self) -> None:
        self._farthest_mm = self._last_mm = float("-inf")
        self.is_too_far = False
        """Whether they ever were farther behind than a belt rolls back."""

    def add(self, reading_mm: float | None) -> None:
        """Account for a reading; None: there is none."""
        if reading_mm is None:
            return
        self._farthest_mm, self._last_mm = max(self._farthest_mm, reading_mm), reading_mm
        self.is_too_far |= self._farthest_mm - reading_mm > _ROLL_BACK_MM

    @property
    def is_running_back(self) -> bool:
        """Return whether the last reading is behind the farthest one."""
        return self._farthest_mm - self._last_mm > LEAST_MM


class ReadingCheck:
    """Follows the readings from frame to frame; bounded in memory."""

    def __init__(self) -> None:
        self._last: BeltPosition | None = None
        """The last position with a reading."""
        self._missing = 0
        """Number of frames without a reading since then."""
        self._standing: tuple[int, BeltPosition] | None = None
        """Number and position of the frame whose reading the later ones repeat."""
        self._speed: float | None = None
        """Speed by the last two readings, mm per unit of the clock."""
        self._running_speed: float | None = None
        """Speed of the belt before the readings stood still, mm per unit of the clock."""

    def find_contradiction(
        self, frame: PushedFrame, motion: BeltMotion, confirmed: int
    ) -> Contradiction | None:
        """Return the contradiction of a frame's reading, or of its absence, with those before.

        ``confirmed`` is the number of the last frame whose motion the material confirmed.
        """
        if self._last is None:
            return None
        if frame.encoder_mm is None:
            self._missing += 1
            first = frame.number + 1 - self._missing
            return Contradiction("silent", first, _NAN, _NAN) if self._missing >= _LEAST_MISSING else None
        self._missing = 0
        if not is_jump(self._last, motion.last, motion.speed, frame.clock, frame.encoder_mm):
            return None
        resumption = self.find_resumption(frame)
        if resumption is not None and resumption.number >= confirmed:
            return Contradiction("resumed", 1 + resumption.number, -1.0, _NAN)
        return Contradiction("jump", frame.number, _NAN, _NAN)

    def find_resumption(self, frame: PushedFrame) -> Resumption | None:
        """Return the motion of a belt that explains a reading far ahead after a standstill, else None."""
        if self._standing is None or not self._running_speed or frame.encoder_mm is None:
            return None
        number, start = self._standing
        elapsed = frame.clock - start.clock
        ahead, by_speed = frame.encoder_mm - (start.encoder_mm or 0.0), self._running_speed * elapsed
        agrees = abs(ahead - by_speed) <= MAX_DISAGREEMENT * by_speed
        return Resumption(number, start, ahead / elapsed) if agrees else None

    def add(self, frame: PushedFrame, place: BeltPosition | None, speed: float | None) -> None:
        """Account for a located frame; ``speed`` is the belt's."""
        if place is None or frame.encoder_mm is None:
            return
        moves = self._last is None or abs(frame.encoder_mm - (self._last.encoder_mm or 0.0)) > LEAST_MM
        if moves or self._standing is None:
            self._standing = frame.number, place
            self._running_speed = speed or self._running_speed
        before = self._last
        if before is not None and before.encoder_mm is not None and place.clock > before.clock:
            self._speed = (frame.encoder_mm - before.encoder_mm) / (place.clock - before.clock)
        self._last = place

    def find_steady_step(
        self, frame: PushedFrame, motion: BeltMotion, found: Contradiction | None
    ) -> float | None:
        """Return the encoder's step where, after ``found``, it agrees with the belt's speed or its own; else None."""
        last = motion.last
        if found is None or found.kind not in _WITHOUT_MATERIAL or last is None:
            return None
        if frame.encoder_mm is None or last.encoder_mm is None:
            return None
        step, elapsed = frame.encoder_mm - last.encoder_mm, frame.clock - last.clock
        for speed in (motion.speed, self._speed):
            expected = 0.0 if speed is None else speed * elapsed
            if expected > LEAST_MM and abs(step - expected) <= MAX_DISAGREEMENT * expected:
                return step
        return None
