"""Attribution of findings to the strips measured by their frame, and by suspect frames before it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from beltscape.core.live.findings import Finding
from beltscape.measure.flow.fusion.buffer import LayerBuffer
from beltscape.measure.flow.motion.pushed_frame import PushedFrame
from beltscape.measure.flow.records.fault_history import FaultHistory
from beltscape.measure.flow.records.strips import Strip, Strips


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
