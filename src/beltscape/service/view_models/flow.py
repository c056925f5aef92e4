"""The current flow: an average over the last seconds of belt travel, and its trend."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, isnan, nan
from typing import Literal

from beltscape.core.belt.flow_record import FlowRecord
from beltscape.core.belt.ledger_entries import BeltRecord, Standing

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
