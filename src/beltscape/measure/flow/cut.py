"""The strip of belt that becomes new in a frame: every mm of belt belongs to exactly one."""

from __future__ import annotations

import numpy as np

from beltscape.measure.flow.motion.belt_motion import Place
from beltscape.measure.flow.records.strips import Strip
from beltscape.measure.flow.seen import Seen


class Cutter:
    """Cuts the belt into one strip per frame, each from where the one before ends."""

    def __init__(self, front_mm: float | None) -> None:
        """``front_mm`` is a belt coordinate up to which the belt is counted already; None: nothing is counted."""
        self._front_mm = front_mm
        self._opening: Strip | None = None

    def cut(self, seen: Seen, place: Place, before: Place | None, window_mm: tuple[float, float]) -> Strip:
        """The strip of belt that is new in this frame.

        ``window_mm`` are the belt coordinates, relative to the frame's place, between which the belt is seen across
        its width, the older end first; ``before`` is the place of the frame before.
        """
        low, high = window_mm
        end = place.position_mm + high
        start = place.position_mm + low
        if self._front_mm is not None:
            start = self._front_mm if before is not None else max(start, self._front_mm)
        self._front_mm = end = max(start, end)
        speed = float("nan")
        if before is not None and seen.time_ns is not None and seen.clock > before.clock:
            speed = (place.position_mm - before.position_mm) / (seen.clock - before.clock)
        position = place.position_mm if seen.encoder_mm is None else seen.encoder_mm
        sure = seen.whole and place.source != "speed"
        step_sigma = place.sigma_mm if before else 0.0
        strip = Strip(seen.frame, seen.time_ns, position, start, end, step_sigma, speed, True, sure)
        if before is None:
            self._opening = strip
        elif self._opening is not None:
            self._opening.speed_mm_s, self._opening = speed, None
        return strip

    def nowhere(self, seen: Seen) -> Strip:
        """A frame of which nothing tells where the belt was: its belt counts with the next frame's strip."""
        front = self._front_mm if self._front_mm is not None else -np.inf
        nan = float("nan")
        position = nan if seen.encoder_mm is None else seen.encoder_mm
        return Strip(seen.frame, seen.time_ns, position, front, front, 0.0, nan, False, False)
