"""The first motion of the material, before any frame has a position: the direction, and a check of the encoder."""

from __future__ import annotations

from collections.abc import Sequence

from beltscape.measure.flow.motion.encoder_check import LEAST_MM, Contradiction, make_contradiction
from beltscape.measure.flow.motion.motion_evidence import LEAST_PAIRS
from beltscape.measure.flow.motion.plausibility import are_consistent, is_confirmed
from beltscape.measure.flow.motion.pushed_frame import PushedFrame
from beltscape.measure.flow.motion.registration.shift import Shift, register


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
