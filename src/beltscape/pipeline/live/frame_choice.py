"""The choice of the frame sets that are matched, by the place of the belt that they show.

A frame set is worth a match by how far the belt has moved between its neighbours. Where more arrive than the computer
can measure, the one goes without which the belt stays seen most evenly. Where the belt rests or creeps, those pass
that show what the last matched one showed.
"""

from __future__ import annotations

from collections.abc import Sequence

from beltscape.core.frames import FrameSet

REPEAT_NS = 1_000_000_000
"""Longest time without a match at rest. A check that takes n frames then takes n s, while no image changes.
A value is shown for 3 s. With 2 s a belt at rest costs half as much."""
ATTENTION_NS = 2_000_000_000
"""Time in which all is matched after the images changed on a belt that stands: what comes suddenly is found in as
many frames as on a moving belt. Twice the second within which a projector that moved is named."""
_COUNTED_MM = 0.05
"""Travel by the encoder from one frame set to the next from which on the images may differ: finer than its jitter is
at rest, and 0.4 mm/s at 8 Hz. Chosen."""


def measure_gap_mm(one: FrameSet, other: FrameSet) -> float | None:
    """Return how far the belt has moved between two frame sets; None where it is not known."""
    if one.position_mm is None or other.position_mm is None:
        return None
    return abs(other.position_mm - one.position_mm)


def find_least_needed(last: FrameSet | None, waiting: Sequence[FrameSet]) -> int:
    """Return which of the waiting frame sets, but for the newest, may go: its neighbours lie closest together.

    ``last`` is the frame set before them. Distances are those of the belt's positions where all are known, else of
    their order. Of equal ones the oldest goes.
    """
    known = [waiting[0] if last is None else last, *waiting]
    if any(one.position_mm is None for one in known):
        return 0
    gaps_mm = [
        measure_gap_mm(before, after) or 0.0 for before, after in zip(known[:-2], known[2:], strict=True)
    ]
    return gaps_mm.index(min(gaps_mm)) if gaps_mm else 0


class RepeatChoice:
    """Tells the frame sets that show the belt of the last matched one, by their positions, cameras and times.

    Whether the images agree with that is for their checks to say.
    """

    def __init__(self, step_mm: float) -> None:
        """``step_mm`` is the travel from which on a further frame set is fused with those before."""
        self._step_mm = step_mm
        self._matched: FrameSet | None = None
        self._before: FrameSet | None = None
        self._attentive_until_ns = 0

    def is_near(self, frames: FrameSet) -> bool:
        """Return whether a frame set shows the belt of the last matched one, in the same cameras."""
        matched = self._matched
        if matched is None or not frames.images or frames.images.keys() != matched.images.keys():
            return False
        gap_mm = measure_gap_mm(matched, frames)
        return gap_mm is not None and gap_mm < self._step_mm

    def is_soon(self, frames: FrameSet) -> bool:
        """Return whether a frame set need not be matched yet, only because of the time."""
        matched = self._matched
        if matched is None or matched.time_ns is None or frames.time_ns is None:
            return False
        is_attentive = frames.time_ns < self._attentive_until_ns
        return 0 <= frames.time_ns - matched.time_ns < REPEAT_NS and not is_attentive

    def has_moved(self, frames: FrameSet) -> bool:
        """Return whether the encoder has counted since the frame set before."""
        gap_mm = None if self._before is None else measure_gap_mm(self._before, frames)
        return gap_mm is not None and gap_mm > _COUNTED_MM

    def compute_speed_mm_s(self, frames: FrameSet) -> float:
        """Return the belt's speed since the frame set before, by the encoder; NaN where it is not known."""
        before = self._before
        if before is None or before.position_mm is None or frames.position_mm is None:
            return float("nan")
        elapsed_s = ((frames.time_ns or 0) - (before.time_ns or 0)) * 1e-9
        return (frames.position_mm - before.position_mm) / elapsed_s if elapsed_s > 0 else float("nan")

    def note_matched(self, frames: FrameSet) -> None:
        """Take over a frame set that is matched."""
        self._matched = self._before = frames

    def note_passed(self, frames: FrameSet) -> None:
        """Take over a frame set that passes."""
        self._before = frames

    def note_change(self, frames: FrameSet) -> None:
        """Have all frame sets matched for a time: images that should repeat do not."""
        self._attentive_until_ns = (frames.time_ns or 0) + ATTENTION_NS
