"""The cutting of the belt into strips, one for each frame, and the attribution of findings to them.

Every mm of belt belongs to exactly one strip. A finding concerns the strips measured by its frame, and by suspect
frames before it: a fault may have been present since the check last passed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from beltscape.core.alarm_catalogue import THIN_OVERLAP
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import make_message
from beltscape.measure.flow.belt_motion import BeltPosition
from beltscape.measure.flow.location import PushedFrame
from beltscape.measure.flow.rows import LayerBuffer
from beltscape.measure.flow.strips import ALL_LENGTHS, ENCODER_LENGTHS, Strip, Strips

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
            scaled_lengths=ALL_LENGTHS if before is None or place.is_in_rig_scale else ENCODER_LENGTHS,
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
        text = make_message("thin_overlap", step=step, view=view)
        limit = (1 - self._overlap) * self._view_mm
        return Finding(THIN_OVERLAP, step, 0.0, limit, "mm", text=text, effect="degraded", is_momentary=True)

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


@dataclass(slots=True)
class FaultHistory:
    """Remembers for each check and camera the last frame that passed it."""

    _passed: dict[tuple[str, str], int] = field(default_factory=dict)

    def add(self, number: int, findings: Iterable[Finding]) -> list[tuple[int, Finding]]:
        """Account for a frame's findings; return each fault with an effect and the first frame that it concerns.

        A check with the value NaN was not made; it neither passed nor failed.
        """
        out: list[tuple[int, Finding]] = []
        for finding in findings:
            key = finding.check, finding.subject
            if finding.effect != "none":
                since = number if finding.is_momentary else self._passed.get(key, -1) + 1
                out.append((min(since, number), finding))
            elif not np.isnan(finding.value):
                self._passed[key] = number
        return out


class FaultAttribution:
    """Gives each strip the findings that concern it: a fault may be older than the frame that shows it."""

    def __init__(self, strips: Strips, buffer: LayerBuffer) -> None:
        self._strips, self._buffer = strips, buffer
        self._history = FaultHistory()

    def add_findings(
        self, number: int, findings: Iterable[Finding], waiting: Sequence[PushedFrame] = ()
    ) -> None:
        """Attribute a frame's faults also to the frames since the check last passed.

        ``waiting`` are the frames that have no strip yet.
        """
        for first, fault in self._history.add(number, findings):
            for frame in waiting:
                if first <= frame.number < number:
                    frame.findings.append(fault)
            self._suspect(first, number, fault)

    def _suspect(self, first: int, number: int, fault: Finding) -> None:
        """Attribute a fault to the waiting strips of frames ``first`` to ``number``, and to what those measured."""
        suspects = [strip for strip in self._strips if first <= strip.number <= number]
        start = min((strip.view_start_mm for strip in suspects), default=np.inf)
        for strip in self._strips:
            if strip.number >= first and fault.effect == "missing":
                strip.is_void |= bool(np.isfinite(strip.view_start_mm))
                strip.add_loss(fault)
            elif strip.number >= first or strip.end_mm > start:
                strip.add_finding(fault)
        if fault.effect == "missing" and suspects:
            self._buffer.discard_from(first)

    def add_since(self, first: int, finding: Finding) -> None:
        """Attribute a finding about the belt's motion to the strips of a frame and of those after it."""
        for strip in self._strips:
            if strip.number >= first:
                strip.add_finding(finding)

    def attach(self, strip: Strip, frame: PushedFrame, view_start_mm: float) -> None:
        """Give a new strip its frame's findings, and its faults to the strips that the frame measured, too.

        ``view_start_mm`` is the beginning of the belt that the frame measured; infinite where it measured none.
        """
        strip.view_start_mm = view_start_mm
        if frame.depth is not None and np.isfinite(view_start_mm):
            for one in (*self._strips, strip):
                if one is strip or one.end_mm > view_start_mm:
                    one.systematic_mm = max(one.systematic_mm, frame.depth.systematic_mm)
        for finding in frame.findings:
            if finding.effect == "missing":
                strip.add_loss(finding)
                continue
            strip.add_finding(finding)
            if finding.effect != "none":
                for other in self._strips:
                    if other.end_mm > view_start_mm:
                        other.add_finding(finding)
