"""Plausibility of a registration, and of an encoder's reading, as the belt's motion.

The encoder's readings are also checked by themselves: jumps, silence, and a standstill while the belt went on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltscape.measure.flow.belt_motion import FASTEST_MM_S, MAX_DISAGREEMENT, BeltMotion, BeltPosition
from beltscape.measure.flow.encoder_check import LEAST_MM, Contradiction, Kind
from beltscape.measure.flow.location import PushedFrame
from beltscape.measure.flow.motion_evidence import LEAST_PAIRS, MotionEvidence
from beltscape.measure.flow.registration import NEXT_MM, HighPassHeights, Shift, match_prediction

LEAST_SUPPORT = 0.02
"""Share of the view that two frames' loads must have in common to contradict an encoder: on three simulated heaps
all registrations that were wrong by more than 1 mm had less."""
_LARGE_SUPPORT = 0.1
"""Share of the view at which other material does not match by chance; a smaller one needs a second reason."""
_STRONG_SCORE = 0.85
"""Correlation that other material does not reach: quasi-periodic heaps up to 0.8, the same material 0.85 to 0.95."""
_CONSTANT_APART = 0.03
"""Spread of the ratios of encoder to material of pairs ``apart``, below which they are not registered by chance."""
_CONSTANT_SPEED = 0.1
"""Speeds by two matches one after the other that differ by less are not by chance."""
_LEAST_RELIEF_MM = 2.0
"""Standing surfaces with less relief along the belt are errors of the empty belt's surface, not material that stands
still; and less relief matches by chance."""
DRAWN_MM = NEXT_MM
"""Up to this shift the correlation of what stands still overlaps with that of what moves: the size of its peak."""
_UNMATCHED_SUPPORT = 0.05
"""Share of the view that the loads must have in common at the prediction for a low score to count."""
_LOW_SCORE = 0.4
"""A score at the predicted motion below this share of the usual one is no match."""
_ROUGH_MM = 5.0
"""Surfaces with this relief match by 0.75 or more where they are the same, whatever their noise."""
_ROUGH_SCORE = 0.75
"""Score that stands for the usual one while few are known, of surfaces with `_ROUGH_MM`."""
_LEAST_SCORES = 3
"""Number of scores from which their median is the usual one: one outlier does not move it."""
_BRAKED_MM_S2 = 3000.0
"""Acceleration of a belt that is braked in an emergency."""
_HIGHEST_ACCELERATION_MM_S2 = 10_000.0
"""No belt starts or stops faster."""
_LEAST_JUMP_MM = 100.0
"""A reading may differ by this from what speed and acceleration allow."""


def differ(motion_mm: float | None, expected_mm: float | None) -> bool:
    """Return whether two motions that are both known differ grossly."""
    if motion_mm is None or expected_mm is None:
        return False
    return abs(motion_mm - expected_mm) > MAX_DISAGREEMENT * abs(expected_mm) + LEAST_MM


def is_certain(
    shift: Shift,
    along_mm: float,
    by_speeds_mm: Sequence[float | None],
    speed_before: float | None,
    elapsed: float,
) -> bool:
    """Return whether a match that contradicts the encoder is not by chance.

    It agrees with one of the last speeds, or a belt can have changed its speed so far, or it is exact; then it must
    have much material, or agree with the match before, by ``speed_before``. ``along_mm`` is its motion along the
    travel, ``by_speeds_mm`` are those by the present speed and by the last confirmed one, ``elapsed`` is the time
    since the key frame.
    """
    if any(one is not None and not differ(along_mm, one) for one in by_speeds_mm):
        return True
    by_speed_mm = by_speeds_mm[0]
    change = 0.0 if by_speed_mm is None else abs(along_mm - by_speed_mm)
    if shift.score < _STRONG_SCORE and change > _LEAST_JUMP_MM + _BRAKED_MM_S2 * elapsed**2:
        return False
    if shift.support >= _LARGE_SUPPORT:
        return True
    if speed_before is None or not shift.clear or elapsed <= 0:
        return False
    return abs(along_mm / elapsed - speed_before) <= _CONSTANT_SPEED * abs(speed_before)


def is_certain_apart(
    shift: Shift, along_mm: float, by_speed_mm: float | None, evidence: MotionEvidence
) -> bool:
    """Return whether the material is surely the same although by the encoder the views do not overlap."""
    if by_speed_mm is not None and not differ(along_mm, by_speed_mm):
        return True
    ratios = evidence.apart_ratios
    is_constant = evidence.apart >= LEAST_PAIRS and ratios.spread < _CONSTANT_APART and ratios.median > 0
    return shift.clear and is_constant and shift.support >= _LARGE_SUPPORT and shift.score >= _STRONG_SCORE


def compute_relief_mm(*frames: HighPassHeights) -> float:
    """Return the least relief along the belt of several frames: the standard deviation of their high-pass heights.

    Each line along the belt counts from its own mean: the cross-section of an even load shows no motion.
    """
    return min(_compute_relief_mm(one) for one in frames)


def _compute_relief_mm(frame: HighPassHeights) -> float:
    """Return the relief along the belt of one frame; 0 without a load."""
    cells = frame.load.sum(axis=0)
    if not cells.any():
        return 0.0
    line_mm = frame.high_pass_mm.sum(axis=0) / np.maximum(cells, 1)
    return float(np.sqrt(np.mean((frame.high_pass_mm - line_mm)[frame.load] ** 2)))


def is_repeated(key: HighPassHeights, after: HighPassHeights, shift: Shift) -> bool:
    """Return whether a registration surely shows a whole load in its place, not a lump or the belt's errors."""
    is_sure = shift.clear and shift.score >= _STRONG_SCORE and shift.support >= _LARGE_SUPPORT
    return is_sure and compute_relief_mm(key, after) >= _LEAST_RELIEF_MM


def is_belt_surface(
    key: HighPassHeights,
    after: HighPassHeights,
    along_mm: float,
    expected_mm: float | None,
    *,
    within_mm: float = LEAST_MM,
) -> bool:
    """Return whether a motion short of the expected one is that of errors that stand still, and not the material's.

    Errors of the empty belt and of matching stay where they are in the view, and a low relief does not outweigh them:
    they show a standstill, or draw the motion towards it where it is within the correlation's peak. Motions up to
    ``within_mm`` are judged.
    """
    is_short = abs(along_mm) < abs(expected_mm or 0.0) - LEAST_MM
    if not is_short or abs(along_mm) > within_mm:
        return False
    return compute_relief_mm(key, after) < _LEAST_RELIEF_MM


def is_unmatched(
    key: HighPassHeights,
    after: HighPassHeights,
    near_mm: float,
    *,
    least_overlap: float,
    usual_scores: Sequence[float],
) -> bool:
    """Return whether the material is surely not where a motion ``near_mm`` along y puts it.

    ``usual_scores`` are the latest correlations of matching frames.
    """
    if not (key.has_load and after.has_load):
        return False
    relief_mm = compute_relief_mm(key, after)
    if relief_mm < _LEAST_RELIEF_MM:
        return False  # an even load matches nowhere: what remains along the belt is noise
    if len(usual_scores) >= _LEAST_SCORES:
        usual = float(np.median(usual_scores))
    elif relief_mm >= _ROUGH_MM:
        usual = _ROUGH_SCORE
    else:
        return False
    match = match_prediction(key, after, least_overlap=least_overlap, near_mm=near_mm)
    return match.support >= _UNMATCHED_SUPPORT and match.score < _LOW_SCORE * usual


def is_jump(
    before: BeltPosition | None,
    last: BeltPosition | None,
    speed: float | None,
    clock: float,
    encoder_mm: float | None,
) -> bool:
    """Return whether no belt can have moved from the last reading ``before`` to this one.

    ``last`` is the last position and ``speed`` the last speed, mm per unit of the clock; None if unknown. Where the
    position was observed between the two, the speed had less time to change.
    """
    if before is None or last is None or encoder_mm is None:
        return False
    since = before if last.source == "speed" else last
    elapsed = max(clock - since.clock, 0.0)
    expected, allowed = 0.0, FASTEST_MM_S * elapsed
    if speed is not None:
        expected = last.position_mm - before.position_mm + speed * max(clock - last.clock, 0.0)
        allowed = min(allowed, _HIGHEST_ACCELERATION_MM_S2 * elapsed**2)
    step = encoder_mm - (before.encoder_mm or 0.0)
    return abs(step - expected) > _LEAST_JUMP_MM + allowed + 0.05 * abs(expected)


def is_sudden(speed: float | None, step_mm: float, elapsed: float) -> bool:
    """Return whether an encoder's step differs from the last speed's by more than braking or a start explains."""
    expected = 0.0 if speed is None else speed * elapsed
    return (
        speed is not None
        and differ(step_mm, expected)
        and (abs(step_mm - expected) > _BRAKED_MM_S2 * elapsed**2)
    )


def is_confirmed(along_mm: float, encoder_mm: float | None, encoder_before_mm: float | None) -> bool:
    """Return whether a first motion is the encoder's step; without an encoder every motion counts as confirmed.

    A chance registration of a thin load may have any length and sign; it must not set the direction of travel.
    """
    if encoder_mm is None or encoder_before_mm is None:
        return True
    step = encoder_mm - encoder_before_mm
    return abs(abs(along_mm) - step) <= MAX_DISAGREEMENT * step + LEAST_MM


def are_consistent(shifts: Sequence[Shift]) -> bool:
    """Return whether first motions that the encoder contradicts are not by chance: long, exact and all alike."""
    usual = float(np.median([shift.along_mm for shift in shifts]))
    return all(
        shift.clear
        and shift.support >= _LARGE_SUPPORT
        and abs(shift.along_mm - usual) <= _CONSTANT_SPEED * abs(usual) + LEAST_MM
        for shift in shifts
    )


_NAN = float("nan")
_ROLL_BACK_MM = 500.0
"""A loaded belt that stops may roll back this far, as in `sources.encoder.track`."""
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
