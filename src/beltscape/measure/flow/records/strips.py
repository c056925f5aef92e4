"""Strips of belt: the queue of those not yet finished, and their flow records."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from beltscape.core.belt.flow_record import FlowRecord, Quality
from beltscape.measure.flow.records.density import Density
from beltscape.measure.flow.records.profile import Profile, Stretch
from beltscape.measure.flow.records.totals import Sums

_MIN_SHARE = 0.7
"""Least measured share of a strip that counts as fully measured."""
_MIN_PART = 0.05
"""Smaller parts of a strip do not affect its quality."""


@dataclass(slots=True)
class Strip:
    """The belt that became new in one frame."""

    frame: str
    time_ns: int | None
    belt_position_mm: float
    """Position for the record; NaN if unknown."""
    start_mm: float
    end_mm: float
    """In belt coordinates."""
    step_sigma_mm: float
    """One standard deviation of the strip's length."""
    speed_mm_s: float
    """NaN if unknown."""
    placed: bool
    """Whether the belt's position was known."""
    reliable: bool
    """Whether the position came from material or encoder, not from the last known speed, with all images present."""


class Strips:
    """A queue of strips in the order of the frames; each becomes a record when its profile is complete."""

    def __init__(self, sums: Sums, density: Density) -> None:
        """Records are also counted in ``sums``."""
        self._sums, self._density = sums, density
        self._waiting: deque[Strip] = deque()

    def add(self, strip: Strip) -> None:
        """Append the next frame's strip."""
        self._waiting.append(strip)

    @property
    def first(self) -> Strip | None:
        """Return the strip that waits longest."""
        return self._waiting[0] if self._waiting else None

    def pop_finished(self, profile: Profile, until_mm: float) -> list[FlowRecord]:
        """Remove the strips that end at or before ``until_mm`` and return their records."""
        out: list[FlowRecord] = []
        while self._waiting and self._waiting[0].end_mm <= until_mm:
            out.append(self._make_record(self._waiting.popleft(), profile))
        return out

    def _make_record(self, strip: Strip, profile: Profile) -> FlowRecord:
        stretch = profile.integrate(strip.start_mm, strip.end_mm)
        area = stretch.volume_mm3 / stretch.length_mm if stretch.length_mm > 0 else float("nan")
        if stretch.length_mm == 0 and strip.placed:
            area = profile.area_at_mm2(strip.end_mm)
        moved = strip.step_sigma_mm * float(np.nan_to_num(area))
        density = self._density.at(strip.time_ns)
        self._sums.add((strip.start_mm, strip.end_mm), stretch, moved, density)
        return FlowRecord(
            frame=strip.frame,
            time_ns=strip.time_ns,
            belt_position_mm=strip.belt_position_mm,
            strip_mm=(strip.start_mm, strip.end_mm),
            area_mm2=area,
            volume_mm3=stretch.volume_mm3,
            sigma_mm3=self._sums.compute_sigma(stretch, moved),
            speed_mm_s=strip.speed_mm_s,
            density_kg_m3=density[0],
            coverage=stretch.share,
            single_coverage=stretch.single_share,
            quality=_classify_quality(strip, stretch),
        )


def _classify_quality(strip: Strip, stretch: Stretch) -> Quality:
    length = stretch.length_mm
    unseen = length - stretch.seen_mm - stretch.bridged_mm
    if not strip.placed or unseen > 0.5 * length:
        return "missing"
    if stretch.bridged_mm > _MIN_PART * length:
        return "bridged"
    if not strip.reliable or unseen > _MIN_PART * length or stretch.share < _MIN_SHARE:
        return "degraded"
    return "measured"
