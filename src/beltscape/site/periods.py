"""Hours, shifts and days of a site in its time zone."""

from __future__ import annotations

from typing import Literal

from beltscape.production.calendar import open_zone
from beltscape.production.shifts import list_production_days, list_shifts
from beltscape.site.settings import SiteSettings

Kind = Literal["hour", "shift", "day"]
_HOUR_S = 3600
"""Seconds of an hour."""
_DAY_NS = 86_400_000_000_000
"""Nanoseconds of a day."""
_S_NS = 1_000_000_000
"""Nanoseconds of a second."""


def list_periods(settings: SiteSettings, kind: Kind, now_s: float, count: int) -> list[tuple[int, int, str]]:
    """Return begin, end (s since 1970) and name of the last ``count`` periods, oldest first; the last has begun.

    Hours are those of UTC, so that none is lost or doubled when the clocks change; only shifts have a name.
    """
    if kind == "hour":
        hour = int(now_s) // _HOUR_S * _HOUR_S
        starts = range(hour - (count - 1) * _HOUR_S, hour + 1, _HOUR_S)
        return [(start, start + _HOUR_S, "") for start in starts]
    zone, now_ns = open_zone(settings.time_zone), round(now_s * _S_NS)
    per_day = len(settings.shifts) if kind == "shift" else 1
    since_ns = now_ns - (count // max(per_day, 1) + 2) * _DAY_NS
    list_all = list_shifts if kind == "shift" else list_production_days
    periods = [one for one in list_all(settings.shifts, zone, since_ns, now_ns) if one.since_ns <= now_ns]
    return [(one.since_ns // _S_NS, one.until_ns // _S_NS, one.name) for one in periods[-count:]]
