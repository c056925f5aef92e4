"""The cutting of the belt into strips, one for each frame: every mm of belt belongs to exactly one strip."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from beltscape.measure.flow.motion.belt_motion import BeltPosition
from beltscape.measure.flow.motion.pushed_frame import PushedFrame
from beltscape.measure.flow.records.strips import Strip


class StripCutter:
    """Cuts the belt into one strip per frame, each from the end of the one before."""

    def __init__(self, front_mm: float | None) -> None:
        """``front_mm`` is a belt coordinate up to which the belt is counted already; None: nothing is counted."""
        self._front_mm = front_mm
        self._opening: Strip | None = None

    def cut(
        self,
        frame: PushedFrame,
        place: BeltPosition,
        before: BeltPosition | None,
        window_mm: tuple[float, float],
    ) -> Strip:
        """Return the strip of belt that is new in this frame.

        ``window_mm`` are the belt coordinates, relative to the frame's position, between which the belt is visible
        across its width, the older end first; ``before`` is the position of the frame before.
        """
        low, high = window_mm
        end = place.position_mm + high
        start = place.position_mm + low
        if self._front_mm is not None:
            start = self._front_mm if before is not None else max(start, self._front_mm)
        self._front_mm = end = max(start, end)
        speed = float("nan")
        if before is not None and frame.time_ns is not None and frame.clock > before.clock:
            speed = (place.position_mm - before.position_mm) / (frame.clock - before.clock)
        position = place.position_mm if frame.encoder_mm is None else frame.encoder_mm
        reliable = frame.whole and place.source != "speed"
        step_sigma = place.sigma_mm if before else 0.0
        strip = Strip(
            frame.frame,
            frame.time_ns,
            position,
            start,
            end,
            step_sigma,
            speed,
            placed=True,
            reliable=reliable,
            number=frame.number,
        )
        if before is None:
            self._opening = strip
        elif self._opening is not None:
            self._opening.speed_mm_s, self._opening = speed, None
        return strip

    def recut(self, strips: Iterable[Strip], places: Mapping[int, BeltPosition], high_mm: float) -> None:
        """Cut the strips of frames with new positions anew; ``high_mm`` is the newer end of the window."""
        front = None
        for strip in strips:
            place = places.get(strip.number)
            if front is None and place is None:
                continue
            strip.start_mm = strip.start_mm if front is None else front
            strip.end_mm = (
                strip.start_mm if place is None else max(strip.start_mm, place.position_mm + high_mm)
            )
            self._front_mm = front = strip.end_mm

    def make_unplaced_strip(self, frame: PushedFrame) -> Strip:
        """Return the empty strip of a frame without a position: its belt counts with the next frame's strip."""
        front = self._front_mm if self._front_mm is not None else -np.inf
        nan = float("nan")
        position = nan if frame.encoder_mm is None else frame.encoder_mm
        return Strip(
            frame.frame,
            frame.time_ns,
            position,
            front,
            front,
            0.0,
            nan,
            placed=False,
            reliable=False,
            number=frame.number,
        )
