"""The current values that alarms are evaluated on, gathered from the engine's threads."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median
from time import monotonic

from beltscape.alarms.readings import Readings
from beltscape.core.depth import DepthMap
from beltscape.core.events import NO_CAPACITY, Capacity
from beltscape.core.findings import Finding
from beltscape.core.ledger import BeltRecord

_NAN = float("nan")
_MINUTE_S = 60.0
"""Dropped frames are counted over the last minute."""
_PACE_FRAMES = 8
"""Intervals of which the median is the usual one: a single late frame changes nothing."""
_PACE_INTERVALS = 3.0
"""Usual intervals without a value after which it is unknown: one frame may be lost and one late."""
_FINDING_S = 60.0
"""A finding older than this is unknown; periodic checks are made more often."""


class FramePace:
    """The usual interval of the frames that are measured, by which their values last."""

    def __init__(self) -> None:
        self._times_s: deque[float] = deque(maxlen=_PACE_FRAMES + 1)

    def add(self, time_s: float) -> None:
        """Add a frame at a time of the monotonic clock."""
        self._times_s.append(time_s)

    def stretch(self, stale_s: float) -> float:
        """Return the age, at least ``stale_s``, from which a value is unknown."""
        times_s = list(self._times_s)
        intervals_s = [later - earlier for earlier, later in pairwise(times_s)]
        return max(stale_s, _PACE_INTERVALS * median(intervals_s)) if intervals_s else stale_s


VIEWS = 2
"""Views of every millimetre that a speed must leave to be held: one may be lost, and two show more than one."""
_LEAST_SETS = 5
"""Frame sets after which the capacity is stated; the first ones also begin matchers and learn references."""
_MOST_SETS = 64
"""Frame sets of which the median is taken: heaps and bare belt take different times."""


class CapacityMeter:
    """Measures how long frame sets take, which the belt's speed and the frame rate do not change.

    With worker processes two things limit what the computer can measure: what the workers match together, and what
    this process does with every frame set by itself. Without them it is the time from one frame set to the next.
    """

    def __init__(self, count_matched_per_s: Callable[[], float] | None) -> None:
        """``count_matched_per_s`` returns what the workers match in a second; None: there are none."""
        self._count_matched_per_s = count_matched_per_s
        self._seconds: deque[float] = deque(maxlen=_MOST_SETS)

    def add(self, elapsed_s: float, own_s: float) -> None:
        """Add a measured frame set: the time that passed, and the part in which this process was busy with it."""
        self._seconds.append(elapsed_s if self._count_matched_per_s is None else own_s)

    def compute(self, window_mm: float) -> Capacity:
        """Return the capacity for a view of ``window_mm`` along the belt; NaN until enough was measured."""
        if len(self._seconds) < _LEAST_SETS:
            return NO_CAPACITY
        sets_per_s = 1 / max(median(self._seconds), 1e-6)
        if self._count_matched_per_s is not None:
            sets_per_s = min(sets_per_s, self._count_matched_per_s())
        return Capacity(sets_per_s, sets_per_s * window_mm / VIEWS)


@dataclass(slots=True)
class Gauges:
    """The latest value of each quantity; every field is written by one thread and read by another."""

    full_area_mm2: float
    stale_s: float = 3.0
    """A value older than this is unknown; frames in longer intervals lengthen it."""
    capacity: Capacity = NO_CAPACITY
    """What the computer can measure with the present settings."""
    pace: FramePace = field(default_factory=FramePace)
    """Interval of the frames."""
    entry: BeltRecord | None = None
    """The last entry with a measured strip."""
    entry_s: float = float("-inf")
    """Monotonic clock at this entry."""
    belt_mm: float = _NAN
    speed_mm_s: float = _NAN
    coverage: float = _NAN
    measured_s: float = float("-inf")
    """Monotonic clock at the last frame that gave depth."""
    last_frame_s: float = float("-inf")
    """Monotonic clock at the last frame of any kind."""
    is_measured: bool = False
    """Whether the last frame that was to be matched gave depth."""
    depth: DepthMap | None = None
    """Of the last frame; None once it was inspected."""
    lump_mm: tuple[float, float] = (_NAN, _NAN)
    """Largest lump and its σ, until the board has them."""
    last_lump_mm: float = _NAN
    """Largest lump at the last search."""
    offset_mm: tuple[float, float] = (_NAN, _NAN)
    """Misalignment of the belt and its σ."""
    dropped: deque[tuple[float, int]] = field(default_factory=deque)
    """(monotonic clock, frame sets dropped so far)."""
    findings: dict[tuple[str, str], tuple[float, Finding]] = field(default_factory=dict)
    """By check and camera: monotonic clock and the latest finding that was made."""
    new_faults: dict[tuple[str, str], Finding] = field(default_factory=dict)
    """By check and camera: the latest fault until the board has it; a fault of a single frame raises its alarm."""
    lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, entries: Sequence[BeltRecord]) -> None:
        """Take over new entries of the ledger."""
        for entry in entries:
            self.belt_mm = entry.belt_mm[1]
            if entry.strip is not None and entry.standing != "missing":
                self.entry, self.entry_s = entry, monotonic()

    def add_findings(self, findings: Sequence[Finding]) -> None:
        """Take over the findings of a frame; a check that was not made keeps its last finding."""
        now = monotonic()
        with self.lock:
            for finding in findings:
                if finding.is_fault or math.isfinite(finding.value):
                    self.findings[finding.check, finding.subject] = now, finding
                if finding.is_fault:
                    self.new_faults[finding.check, finding.subject] = finding

    def update_frame(self, depth: DepthMap | None, speed_mm_s: float) -> None:
        """Take over the result of a frame."""
        self.last_frame_s = monotonic()
        self.pace.add(self.last_frame_s)
        self.is_measured = depth is not None
        self.measured_s = self.last_frame_s if self.is_measured else self.measured_s
        self.speed_mm_s, self.depth = speed_mm_s, depth
        self.coverage = 0.0 if depth is None else depth.coverage

    def update_repeat(self, speed_mm_s: float) -> None:
        """Take over a frame that shows the belt of the last measured one: what was measured there holds for it."""
        self.last_frame_s = monotonic()
        self.measured_s = self.last_frame_s if self.is_measured else self.measured_s
        self.speed_mm_s = speed_mm_s

    def count_dropped(self, total: int) -> float:
        """Return the number of frame sets dropped in the last minute."""
        now = monotonic()
        self.dropped.append((now, total))
        while len(self.dropped) > 1 and now - self.dropped[1][0] > _MINUTE_S:
            self.dropped.popleft()
        return float(total - self.dropped[0][1])

    def collect_readings(self, dropped: int) -> Readings:
        """Return the current readings of the measurement; a value that is measured periodically is returned once.

        ``dropped`` is the number of frame sets dropped so far.
        """
        with self.lock:
            lump, self.lump_mm = self.lump_mm, (_NAN, _NAN)
            offset, self.offset_mm = self.offset_mm, (_NAN, _NAN)
            now = monotonic()
            found = {
                key: finding for key, (made_s, finding) in self.findings.items() if now - made_s < _FINDING_S
            }
            found |= self.new_faults
            self.new_faults = {}
        stale_s = self.pace.stretch(self.stale_s)
        # strips that were measured before go on arriving while the belt leaves the view
        is_measured = now - self.entry_s < stale_s and now - self.measured_s < stale_s
        area, area_sigma, density = self._load() if is_measured else (_NAN, _NAN, _NAN)
        is_current = now - self.last_frame_s < stale_s
        speed = self.speed_mm_s if is_current else _NAN
        per_hour = speed * 3600e-9
        return Readings(
            area_mm2=area,
            area_sigma_mm2=area_sigma,
            full_area_mm2=self.full_area_mm2,
            volume_flow_m3_h=area * per_hour,
            volume_flow_sigma_m3_h=area_sigma * per_hour,
            mass_flow_t_h=area * per_hour * density * 1e-3,
            mass_flow_sigma_t_h=area_sigma * per_hour * density * 1e-3,
            belt_mm=self.belt_mm,
            speed_mm_s=speed,
            coverage=self.coverage if is_current else _NAN,
            largest_lump_mm=lump[0],
            largest_lump_sigma_mm=lump[1],
            belt_offset_mm=offset[0],
            belt_offset_sigma_mm=offset[1],
            dropped_per_minute=self.count_dropped(dropped),
            capacity=self.capacity,
            findings=list(found.values()),
        )

    def _load(self) -> tuple[float, float, float]:
        """Return cross-section, its σ and bulk density of the last measured strip."""
        strip = None if self.entry is None else self.entry.strip
        if strip is None:
            return _NAN, _NAN, _NAN
        length = strip.strip_mm[1] - strip.strip_mm[0]
        sigma = strip.sigma_mm3 / length if length > 0 else _NAN
        return strip.area_mm2, sigma, strip.density_kg_m3
