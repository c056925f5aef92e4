"""The cutting of the belt into strips, one for each frame: every mm of belt belongs to exactly one strip."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from beltscape.core.live.findings import Finding
from beltscape.core.live.translatable_message import Message
from beltscape.measure.flow.motion.belt_motion import BeltPosition
from beltscape.measure.flow.motion.pushed_frame import PushedFrame
from beltscape.measure.flow.records.strips import Strip

_LEAST_THIN = 2
"""Number of steps with too little overlap, one after the other, from which the frame rate is too low."""


class StripCutter:
    """Cuts the belt into one strip per frame, each from the end of the one before."""

    def __init__(
        self, front_mm: float | None, seen_mm: tuple[float, float] = (-np.inf, np.inf), overlap: float = 0.0
    ) -> None:
        """``front_mm`` is a belt coordinate up to which the belt is counted already; None: nothing is counted.

        Frames, which see the range ``seen_mm`` of y, must have the share ``overlap`` of it in common.
        """
        self._front_mm = front_mm
        self._opening: Strip | None = None
        self._view_mm, self._overlap = seen_mm[1] - seen_mm[0], overlap
        self._measured: tuple[float, Strip] | None = None
        """Position and strip of the last frame that measured."""
        self._thin_mm: list[float] = []
        """The latest steps, one after the other, between frames with too little in common."""

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
        self._check_overlap(frame, place, strip)
        if before is None:
            self._opening = strip
        elif self._opening is not None:
            self._opening.speed_mm_s, self._opening = speed, None
        return strip

    def _check_overlap(self, frame: PushedFrame, place: BeltPosition, strip: Strip) -> None:
        """Mark the strips of two frames that have hardly any belt in common: only their views' margins show it."""
        if not frame.is_measured:
            return
        before, self._measured = self._measured, (place.position_mm, strip)
        step = 0.0 if before is None else place.position_mm - before[0]
        if before is None or step <= (1 - self._overlap) * self._view_mm:
            self._thin_mm = []
            return
        self._thin_mm = [*self._thin_mm[1 - _LEAST_THIN :], step]
        strip.reliable = before[1].reliable = False

    def find_thin_overlap(self) -> Finding | None:
        """Return the finding of a belt that is too fast for the frame rate; None before several such steps."""
        if len(self._thin_mm) < _LEAST_THIN:
            return None
        step, view = round(self._thin_mm[-1]), round(self._view_mm)
        text = Message(
            f"the belt moves by {step} mm between frames that see {view} mm of it: raise the frame rate, or let the "
            "core camera see more of the belt",
            "thin_overlap",
            step=step,
            view=view,
        )
        limit = (1 - self._overlap) * self._view_mm
        return Finding(
            "thin_overlap", step, 0.0, limit, "mm", text=text, effect="degraded", is_momentary=True
        )

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
