"""The observation of the belt's motion: each frame's load is registered with that of a key frame, and judged."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.findings import worst_effect
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.flow.belt_motion import MAX_DISAGREEMENT, BeltMotion
from beltscape.measure.flow.encoder_check import LEAST_MM, Contradiction, EncoderCheck, Interval
from beltscape.measure.flow.foreign_objects import ForeignObjectCheck
from beltscape.measure.flow.location import Observation, PushedFrame, UnconfirmedTravel
from beltscape.measure.flow.motion_evidence import MotionEvidence
from beltscape.measure.flow.plausibility import (
    DRAWN_MM,
    LEAST_SUPPORT,
    RollBack,
    differ,
    is_belt_surface,
    is_certain,
    is_certain_apart,
    is_repeated,
    is_unmatched,
)
from beltscape.measure.flow.registration import HighPassHeights, Shift, register
from beltscape.measure.flow.settings import FlowSettings

_USUAL_SCORES = 16
"""Number of latest correlations that are kept as the usual ones."""
_LEAST_UNMATCHED = 2
"""Number of frames without a match after which the encoder's prediction is wrong; one frame may be bad itself."""


class KeyFrame:
    """Heights of the key frame; replaced as the belt moves."""

    def __init__(self, least_overlap: float) -> None:
        self.heights: HighPassHeights | None = None
        """None: no frame yet, or one without a depth map."""
        self.number = 0
        self._least_overlap = least_overlap
        self._scores: deque[float] = deque(maxlen=_USUAL_SCORES)
        self._unmatched = 0

    @property
    def has_load(self) -> bool:
        """Return whether the key frame has enough load for registration."""
        return self.heights is not None and self.heights.has_load

    def replace(self, frame: PushedFrame) -> None:
        """Make a frame the key frame."""
        self.heights, self.number = frame.high_pass, frame.number

    def register(self, heights: HighPassHeights, near_mm: float | None) -> Shift | None:
        """Return the motion of the material since the key frame; ``near_mm`` is the prediction along y."""
        if self.heights is None:
            return None
        return register(self.heights, heights, least_overlap=self._least_overlap, near_mm=near_mm)

    def leave_out(self, number: int, cells: NDArray[np.bool_], noise_mm: float) -> None:
        """Leave cells (Ny, Nx) that are no load out of the key frame, if it is frame ``number``."""
        if self.heights is not None and self.number == number:
            self.heights = self.heights.leave_out(cells, noise_mm)

    def add_match(self, score: float) -> None:
        """Note the correlation of a frame that matches."""
        self._scores.append(score)

    def is_unmatched(self, frame: PushedFrame, near_mm: float) -> bool:
        """Return whether the material of a sound frame is not where a motion ``near_mm`` along y puts it."""
        if self.heights is None or frame.high_pass is None or worst_effect(frame.findings) != "none":
            return False
        return is_unmatched(
            self.heights,
            frame.high_pass,
            near_mm,
            least_overlap=self._least_overlap,
            usual_scores=self._scores,
        )

    def reset_unmatched(self) -> None:
        """Note that a frame matches."""
        self._unmatched = 0

    def count_unmatched(self) -> bool:
        """Count a frame that does not match; return whether their number contradicts the prediction."""
        self._unmatched = (self._unmatched + 1) % _LEAST_UNMATCHED
        return self._unmatched == 0


_SIGMAS = 4.0
"""A motion counts if it exceeds this many σ of its registration, as in `encoder_check`."""
_STALL_STEPS = 4.0
"""An encoder certainly counts on if its step is longer than this multiple of what counts as none. Chosen."""


@dataclass(frozen=True, slots=True)
class _Expectation:
    """The expected motion along the travel since the key frame."""

    trusted: bool
    """Whether there is a reading, and the encoder is trusted."""
    along_mm: float | None
    """By the encoder, or by the speed."""
    by_speed_mm: float | None
    near_mm: float | None
    """``along_mm`` where a registration can find it; else None."""
    is_beyond: bool
    """Whether the views do not overlap by the encoder."""

    @property
    def apart(self) -> bool:
        """Return whether a trusted encoder tells that the views do not overlap."""
        return self.trusted and self.is_beyond


class MaterialObserver:
    """Observes the material's motion since a key frame, its direction, and its agreement with the encoder."""

    def __init__(
        self, reference: EmptyBeltReference, settings: FlowSettings, foreign: ForeignObjectCheck
    ) -> None:
        """``foreign`` finds what is no load."""
        self.motion = BeltMotion()
        self.evidence = MotionEvidence()
        self.check = EncoderCheck(settings.encoder_tolerance)
        self.direction = {None: 0, "+y": 1, "-y": -1}[settings.direction]
        """+1 towards +y, -1 towards -y, 0 if not known yet."""
        self.is_assumed = False  # whether the direction is only assumed
        self._reference, self._settings, self._foreign = reference, settings, foreign
        low, high = reference.seen_mm
        self.reach_mm = (1 - settings.least_overlap) * (high - low)
        """Longest motion between two frames that can be registered."""
        self._key = KeyFrame(settings.least_overlap)
        self._open: tuple[Interval, bool] | None = None
        """The interval from the key frame to the last one, and whether encoder and material agree on it."""
        self._speed_by_match: float | None = None
        """Speed by the last registration, mm per unit of the clock."""
        self._travel = UnconfirmedTravel()
        self._rolled_back = RollBack()
        self._shown_mm: float | None = None
        """Position of the belt that the images of the last registered frame showed."""

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

    def leave_out(self, number: int, cells: NDArray[np.bool_]) -> None:
        """Register later frames without cells (Ny, Nx) of frame ``number`` that are no load."""
        self._key.leave_out(number, cells, self._reference.belt.noise_mm)

    def _observe(self, frame: PushedFrame, reading_mm: float | None) -> Observation:
        """Observe the motion since the key frame; ``reading_mm`` is the encoder's, None where it is not trusted."""
        if self._key.heights is None or frame.high_pass is None:
            return Observation()
        expected = self._expect(frame, reading_mm)
        shift, by_encoder = self._register(frame.high_pass, expected)
        if expected.trusted and shift is not None and self._is_stalled(frame, shift):
            before = self._count_conflicts(frame, shift, expected)
            self.evidence.by_encoder += self.evidence.conflicting - before
            return Observation("standing")
        if not expected.apart:
            self._turn(frame, shift)
        before = self._count_conflicts(frame, shift, expected)
        if shift is None or not self._is_credible(frame, shift, expected):
            self.evidence.by_encoder += self.evidence.conflicting - before
            return self._observe_unmatched(frame, expected)
        self._key.reset_unmatched()
        contradiction = None if by_encoder else self._compare(frame, shift)
        if expected.trusted and contradiction is not None and contradiction.kind == "standing":
            self._open = None
            return Observation("standing")
        return Observation("matched", shift, contradiction)

    def _expect(self, frame: PushedFrame, reading_mm: float | None) -> _Expectation:
        """Return the expected motion since the key frame; ``reading_mm`` is that of a trusted encoder, else None."""
        by_speed, trusted = self.motion.predict_from_speed_mm(frame.clock), reading_mm is not None
        along = self.motion.predict_mm(frame.clock, frame.encoder_mm)
        if not trusted and by_speed is not None:
            along = by_speed
        is_in_view = (1 - MAX_DISAGREEMENT) * abs(along or 0.0) <= self.reach_mm
        is_beyond = (1 - MAX_DISAGREEMENT) * abs(self._encoder_step_mm(frame) or 0.0) > self.reach_mm
        near = along if is_in_view and not self.is_assumed else None
        return _Expectation(trusted, along, by_speed, near, is_beyond)

    def _register(self, heights: HighPassHeights, expected: _Expectation) -> tuple[Shift | None, bool]:
        """Return the registration with the key frame, and whether the encoder selected it of several."""
        near, by_speed = expected.near_mm, expected.by_speed_mm
        shift = self._key.register(heights, None if near is None else self.direction * near)
        by_encoder = expected.trusted and shift is not None and not shift.clear
        if shift is None and expected.trusted and not self.is_assumed and differ(by_speed, expected.along_mm):
            shift, by_encoder = self._key.register(heights, self.direction * (by_speed or 0.0)), False
        if near is None or expected.apart:
            return shift, by_encoder
        if shift is None or differ(self.direction * shift.along_mm, near):
            without = self._register_without_foreign(heights, near)
            if without is not None:
                return without, False
        return shift, by_encoder

    def _observe_unmatched(self, frame: PushedFrame, expected: _Expectation) -> Observation:
        """Return the observation of a frame whose motion is unknown."""
        key, near = self._key, expected.near_mm
        # not where the encoder puts it; while it is not trusted: not where a standstill puts it
        if expected.apart or near is None:
            return Observation()
        if not key.is_unmatched(frame, self.direction * near if expected.trusted else 0.0):
            return Observation()
        if not expected.trusted or not key.count_unmatched():
            return Observation("elsewhere")
        first = 1 + min(key.number, self.check.agreed)
        return Observation("elsewhere", None, Contradiction("unmatched", first, np.nan, np.nan))

    def _count_conflicts(self, frame: PushedFrame, shift: Shift | None, expected: _Expectation) -> int:
        """Count a registration as evidence; return the number of conflicts before it."""
        before = self.evidence.conflicting
        step_mm = self._encoder_step_mm(frame)
        if shift is not None and step_mm is not None and expected.is_beyond:
            self.evidence.add_apart(shift, self.direction, step_mm)
        elif shift is not None:
            self.evidence.add(shift, self.direction, step_mm)
        return before

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
        here, earlier = self._foreign.preview(key.position_mm + near_mm, self.direction, heights.surface_mm)
        gone = earlier.get(self._key.number, np.zeros_like(here))
        if not (here.any() or gone.any()):
            return None
        shift = register(
            self._key.heights.leave_out(gone, noise_mm),
            heights.leave_out(here, noise_mm),
            least_overlap=self._settings.least_overlap,
            near_mm=self.direction * near_mm,
        )
        if shift is None or differ(self.direction * shift.along_mm, near_mm):
            return None
        return shift if shift.support >= LEAST_SUPPORT else None

    def _is_credible(self, frame: PushedFrame, shift: Shift, expected: _Expectation) -> bool:
        """Return whether a registration is the material's motion and not a match by chance."""
        key = self._key.heights
        if key is None or self.motion.key is None or frame.high_pass is None:
            return True
        along, elapsed = self.direction * shift.along_mm, self._compute_elapsed(frame)
        speed_before, self._speed_by_match = self._speed_by_match, along / elapsed if elapsed > 0 else None
        if expected.apart:
            # by the encoder the views do not overlap: then a similar surface is other material
            return is_certain_apart(shift, along, expected.by_speed_mm, self.evidence)
        within = DRAWN_MM if expected.trusted else LEAST_MM
        if is_belt_surface(key, frame.high_pass, along, expected.along_mm, within_mm=within):
            return False
        step = self._encoder_step_mm(frame)
        if self.check.is_trusted and (step is None or not differ(along, step / self.motion.scale.ratio)):
            return True
        by_speeds = (expected.by_speed_mm, self._travel.predict_motion_mm(elapsed))
        return is_certain(shift, along, by_speeds, speed_before, elapsed)

    def _turn(self, frame: PushedFrame, shift: Shift | None) -> None:
        """Replace an assumed direction by that of the material's motion.

        While encoder and material run back together, the direction is that of a belt that rolls back, until this
        takes longer than a belt does: then the encoder counts in reverse.
        """
        if shift is None or not self.is_assumed or abs(shift.along_mm) <= LEAST_MM:
            return
        along, step = (1 if shift.along_mm > 0 else -1), self._encoder_step_mm(frame)
        if step is None or step >= -LEAST_MM:
            self.is_assumed, self.direction = False, along
            return
        self.is_assumed = not self._rolled_back.is_too_far
        self.direction = -along if self.is_assumed else along

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

    def _encoder_step_mm(self, frame: PushedFrame) -> float | None:
        """Return the raw encoder's step since the key frame; None without an encoder."""
        key = self.motion.key
        if key is None or key.encoder_mm is None or frame.encoder_mm is None:
            return None
        return frame.encoder_mm - key.encoder_mm

    def _compute_elapsed(self, frame: PushedFrame) -> float:
        """Return the time since the key frame; 0 without one."""
        return frame.clock - (self.motion.key or frame).clock
