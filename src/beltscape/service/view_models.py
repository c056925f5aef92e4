"""View models of the page, in bounded memory: the live state at one instant, and what it is made of.

The current flow is an average over the last seconds of belt travel, with its trend. Processing times of frame sets
make a histogram; a camera's last image is a small WebP picture.
"""

from __future__ import annotations

import time
from bisect import bisect_left
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from math import inf, isfinite, isnan, nan
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.alarms import Alarm
from beltscape.core.events import NO_CAPACITY, CameraHealth, Capacity, Maintenance
from beltscape.core.findings import Finding
from beltscape.core.frames import Image
from beltscape.core.ledger import BeltRecord, FlowRecord, Standing, Totals

Trend = Literal["rising", "falling", "steady", "unknown"]
_TREND_S = 60.0
"""Time over which the flow is compared with the flow before: longer than the gaps between lumps. Chosen."""
_TREND_SHARE = 0.04
"""Relative change from which a trend is shown, beside two σ; smaller ones would make the arrow flicker. Chosen."""
_LEAST_TREND_S = 5.0
"""Least time of the flow before for a trend. Chosen."""
_MOST_STRIPS = 20_000
"""Number of strips that are kept, which bounds the memory: minutes even of short strips on a fast belt."""
_STOPPED_MM_S = 1.0
"""At a lower speed the belt counts as stopped; the alarm has its own limit."""


@dataclass(frozen=True, slots=True)
class CurrentFlow:
    """Flow over the last seconds of belt travel; NaN: not known."""

    volume_m3_h: float = nan
    """Volume flow."""
    sigma_m3_h: float = nan
    """One standard deviation; the strips' errors are taken as fully correlated, so it is not too small."""
    mass_t_h: float = nan
    """Mass flow; NaN without a density."""
    mass_sigma_t_h: float = nan
    """One standard deviation of the mass flow, from the volume alone."""
    area_mm2: float = nan
    """Mean cross-section of the load."""
    coverage: float = nan
    """Share of the strips that was measured, 0..1."""
    trend: Trend = "unknown"
    """Trend against the minute before; a change smaller than 2 σ or 4 % is steady."""
    change: float = nan
    """Relative change against the minute before."""
    standing: Standing = "missing"
    """The worst standing of the strips in it."""
    age_s: float = inf
    """Seconds since the last measured record arrived; inf: there was none."""


@dataclass(frozen=True, slots=True)
class _Strip:
    seconds: float
    volume_mm3: float
    sigma_mm3: float
    mass_kg: float
    length_mm: float
    coverage: float
    standing: Standing


class FlowAverage:
    """Averages the strips of the last minute of belt travel. Not thread-safe."""

    def __init__(self, window_s: float, *, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._window_s, self._monotonic_s = window_s, monotonic_s
        self._measured_s = -inf
        """Clock at the last measured record."""
        self._standing: Standing = "missing"
        """Standing of that record."""
        self._strips: deque[_Strip] = deque(maxlen=_MOST_STRIPS)
        self._speed_mm_s = nan

    def add(self, records: Sequence[BeltRecord]) -> None:
        """Add finished records, in order."""
        for record in records:
            strip = record.strip
            if strip is not None and _is_measured(record, strip):
                self._measured_s, self._standing = self._monotonic_s(), record.standing
            if strip is not None and isfinite(strip.speed_mm_s):
                self._speed_mm_s = strip.speed_mm_s
            if not self._speed_mm_s > _STOPPED_MM_S or record.length_mm <= 0:
                continue
            coverage = 0.0 if strip is None else strip.coverage
            self._strips.append(
                _Strip(
                    record.length_mm / self._speed_mm_s,
                    record.volume_mm3,
                    record.sigma_mm3,
                    record.mass_kg,
                    record.length_mm,
                    coverage,
                    record.standing,
                )
            )
        kept = sum(strip.seconds for strip in self._strips)
        while self._strips and kept - self._strips[0].seconds > _TREND_S + self._window_s:
            kept -= self._strips.popleft().seconds

    def compute(self, speed_mm_s: float, stale_s: float = 3.0, depth_age_s: float = 0.0) -> CurrentFlow:
        """Return the flow, given the current speed of the belt (NaN: not known).

        It is unknown without a measured record, or a frame with depth, for ``stale_s``, whatever the belt does.
        Strips measured before go on arriving while the belt leaves the view; ``depth_age_s``: of the last depth.
        """
        age_s = max(self._monotonic_s() - self._measured_s, depth_age_s)
        if age_s > stale_s:
            return CurrentFlow(age_s=age_s)
        if speed_mm_s <= _STOPPED_MM_S:
            return CurrentFlow(0.0, 0.0, 0.0, 0.0, nan, nan, "steady", nan, self._standing, age_s)
        return replace(self._average(), age_s=age_s)

    def _average(self) -> CurrentFlow:
        """Return the average over the window; unknown without a strip in it that was measured."""
        last, before = self._split_strips()
        if not last:
            return CurrentFlow()
        standings = {strip.standing for strip in last}
        worst: Standing = next(name for name in ("missing", "degraded", "valid") if name in standings)
        counted = [strip for strip in last if strip.standing != "missing"]
        seconds, length_mm = (
            sum(strip.seconds for strip in counted),
            sum(strip.length_mm for strip in counted),
        )
        if not seconds:
            return CurrentFlow()
        volume = sum(strip.volume_mm3 for strip in counted) / seconds * 3600e-9
        sigma = sum(strip.sigma_mm3 for strip in counted) / seconds * 3600e-9
        mass = sum(strip.mass_kg for strip in counted) / seconds * 3.6
        trend, change = _compute_trend(volume, sigma, before)
        return CurrentFlow(
            volume,
            sigma,
            mass,
            mass * sigma / volume if volume > 0 else nan,
            sum(strip.volume_mm3 for strip in counted) / length_mm,
            sum(strip.coverage * strip.length_mm for strip in counted) / length_mm,
            trend,
            change,
            worst,
        )

    def _split_strips(self) -> tuple[list[_Strip], list[_Strip]]:
        """Return the strips of the window, and those of the minute before it."""
        last: list[_Strip] = []
        seconds = 0.0
        strips = list(self._strips)
        while strips and (not last or seconds < self._window_s * (1 - 1e-9)):
            last.append(strips.pop())
            seconds += last[-1].seconds
        return last, [strip for strip in strips if strip.standing != "missing"]


def _is_measured(record: BeltRecord, strip: FlowRecord) -> bool:
    """Return whether a record tells what lies on the belt: a camera saw a part of it."""
    return record.standing != "missing" and record.cameras > 0 and strip.coverage > 0


def _compute_trend(volume: float, sigma: float, before: list[_Strip]) -> tuple[Trend, float]:
    seconds = sum(strip.seconds for strip in before)
    if seconds < _LEAST_TREND_S:
        return "unknown", nan
    previous = sum(strip.volume_mm3 for strip in before) / seconds * 3600e-9
    change = (volume - previous) / previous if previous > 0 else nan
    if isnan(change) or abs(volume - previous) < max(2 * sigma, _TREND_SHARE * max(previous, volume)):
        return "steady", change
    return ("rising" if volume > previous else "falling"), change


@dataclass(frozen=True, slots=True)
class FlowPoint:
    """The flow at one instant, for the chart."""

    wall_ms: int
    """System clock, ms since 1970."""
    flow: CurrentFlow
    """The flow at that instant."""


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """Counts and timing of frame sets."""

    done: int = 0
    """Measured since the start."""
    dropped: int = 0
    """Skipped since the start."""
    waiting: int = 0
    """Number of frame sets in the queue."""
    seconds: float = nan
    """Time that the last one took."""
    coverage: float = nan
    """Share of the last one that was measured."""
    speed_mm_s: float = nan
    """Speed of the belt at the last one; NaN: not known."""
    largest_lump_mm: float = nan
    """Sieve size of the largest lump at the last search; NaN: none was made."""
    full_area_mm2: float = nan
    """Cross-section of the fully loaded belt; NaN: not known."""
    capacity: Capacity = NO_CAPACITY
    """What the computer can measure."""
    repeated: int = 0
    """Not matched since the start, as they showed the belt of the last one."""


@dataclass(frozen=True, slots=True)
class CheckState:
    """The newest finding of one check."""

    finding: Finding
    wall_ns: int
    """System clock when it was made."""
    age_s: float
    """Seconds since then."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The whole live state without pictures, at one instant."""

    wall_ns: int
    """System clock."""
    frames: FrameStatistics
    """Counts and timing of frame sets."""
    flow: CurrentFlow
    """Volume and mass flow."""
    totals: Totals
    """The ledger's sums."""
    cameras: tuple[CameraHealth, ...]
    """Cameras in the order of their names."""
    alarms: tuple[Alarm, ...]
    """All alarms in their current state."""
    notes: tuple[tuple[int, str], ...]
    """The last messages: system clock in ms, text."""
    frame_age_s: float
    """Seconds since the last frame set was processed; inf: none yet."""
    health_age_s: float
    """Seconds since the cameras' health was last reported; inf: never."""
    record: int | None
    """Number of the newest record; None while there is none."""
    picture_frames: Mapping[str, str]
    """Frame name of the newest picture of every camera that has sent one."""
    maintenance: Maintenance | None
    """The present maintenance; None: there is none."""
    stale_s: float
    """Age from which a frame or a record is not current: the setting, or more for frames in longer intervals."""


DURATION_BOUNDS_S = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0)
"""Upper bounds of the bins, which contain the times of all presets and sizes; a last bin has no bound."""


class DurationHistogram:
    """Counts since the start. Written by one thread at a time."""

    def __init__(self) -> None:
        self._counts = [0] * (len(DURATION_BOUNDS_S) + 1)
        self._sum_s = 0.0

    def add(self, seconds: float) -> None:
        """Count one time; NaN, infinite and negative times are ignored."""
        if isfinite(seconds) and seconds >= 0:
            self._counts[bisect_left(DURATION_BOUNDS_S, seconds)] += 1
            self._sum_s += seconds

    def compute_cumulative(self) -> tuple[tuple[int, ...], float]:
        """Return the counts up to each bound and in total, and the sum in seconds."""
        return tuple(accumulate(self._counts)), self._sum_s


_RECENT_DELAYS = 4096
"""Records of which the latency is stated: some minutes at the fastest rates."""
_OPEN_FRAMES = 4096
"""Frames without a record that are remembered; a belt at rest gives each frame its record at once."""


@dataclass(frozen=True, slots=True)
class Latency:
    """Distribution of a delay over the last records or frame sets; NaN before the first."""

    records: int
    """Records or frame sets of which it is known, since the start."""
    median_s: float
    most_90_s: float
    """Nine of ten took no longer."""
    most_99_s: float
    """99 of 100."""
    worst_s: float


class _Delays:
    """The delays of the last records."""

    def __init__(self) -> None:
        self._recent_s: deque[float] = deque(maxlen=_RECENT_DELAYS)
        self._count = 0

    def add(self, seconds: float) -> None:
        """Add a delay."""
        self._count += 1
        self._recent_s.append(seconds)

    def summarise(self) -> Latency:
        """Return the distribution over the last records."""
        recent = sorted(self._recent_s)
        if not recent:
            return Latency(0, nan, nan, nan, nan)
        median, most_90, most_99 = (
            recent[min(int(share * len(recent)), len(recent) - 1)] for share in (0.5, 0.9, 0.99)
        )
        return Latency(self._count, median, most_90, most_99, recent[-1])


@dataclass(frozen=True, slots=True)
class _Arrival:
    """A frame set."""

    at_s: float
    """When it arrived."""
    position_mm: float
    """The encoder's reading; NaN: not known."""


class LatencyMeter:
    """Measures how long after its frame set a record is published: stored, and passed to page and protocols.

    The belt of a record has to leave the view first, and the holes behind it are filled then. So the delay is also
    measured from the last frame set that saw the record's belt on: that is what the computer takes.
    """

    def __init__(self) -> None:
        self.histogram = DurationHistogram()
        """Of the delay of records from their own frame set on."""
        self.records, self.after_view, self.frames = _Delays(), _Delays(), _Delays()
        """Of records from their own frame set on, and from the last one that saw their belt on; of frame sets."""
        self._arrivals: OrderedDict[str, _Arrival] = OrderedDict()
        self._last: deque[_Arrival] = deque(maxlen=_OPEN_FRAMES)
        self._view_mm = nan

    def add_frame(self, frame: str, seconds: float, now_s: float, position_mm: float, view_mm: float) -> None:
        """Note a frame set that was measured ``seconds`` after its arrival, at a position of the belt.

        ``view_mm`` is the length of belt that it sees; NaN: not known, as the position may be.
        """
        arrival, self._view_mm = _Arrival(now_s - seconds, position_mm), view_mm
        self.frames.add(seconds)
        self._arrivals[frame] = arrival
        self._last.append(arrival)
        while len(self._arrivals) > _OPEN_FRAMES:
            self._arrivals.popitem(last=False)

    def add_record(self, frame: str, published_s: float) -> None:
        """Note when the record of a frame was published; one whose frame set is not known has no latency."""
        arrival = self._arrivals.pop(frame, None)
        if arrival is None:
            return
        self.records.add(published_s - arrival.at_s)
        self.histogram.add(published_s - arrival.at_s)
        left_mm = arrival.position_mm + self._view_mm
        last = next((one for one in reversed(self._last) if one.position_mm < left_mm), None)
        if last is not None:
            self.after_view.add(published_s - last.at_s)


PICTURE_MEDIA_TYPE = "image/webp"
_QUALITY = 72
"""Quality of WebP; Google's default is 75. Chosen for the size of the pictures."""


@dataclass(frozen=True, slots=True)
class Picture:
    """An encoded picture."""

    frame: str
    """Name of its frame."""
    wall_ns: int
    """System clock at its arrival."""
    data: bytes
    """WebP file."""


def convert_to_8_bit(image: Image) -> NDArray[np.uint8]:
    """Return the image in 8 bits; deeper images are shifted by the bits in use."""
    if image.dtype == np.uint8:
        return image.astype(np.uint8, copy=False)
    bits = max(int(image.max(initial=1)).bit_length(), 8)
    used = next(depth for depth in (8, 10, 12, 14, 16) if depth >= bits)
    return (image >> (used - 8)).astype(np.uint8)


def encode_thumbnail(image: Image, longest_px: int) -> bytes:
    """Return a grey or RGB image as WebP, its longer side at most ``longest_px``."""
    height, width = image.shape[:2]
    scale = min(longest_px / max(height, width), 1.0)
    size = (max(round(width * scale), 1), max(round(height * scale), 1))
    small = convert_to_8_bit(cv2.resize(image, size, interpolation=cv2.INTER_AREA) if scale < 1 else image)
    bgr = small if small.ndim == 2 else np.ascontiguousarray(small[..., ::-1])
    return cv2.imencode(".webp", bgr, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])[1].tobytes()
