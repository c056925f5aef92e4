"""Which day a moment belongs to."""

from __future__ import annotations

from datetime import date, timedelta

HOUR_NS = 3_600_000_000_000
DAY_NS = 24 * HOUR_NS
_EPOCH = date(1970, 1, 1)


def shift_ns_of(begins_utc_h: float) -> int:
    """From UTC's midnight to where days begin."""
    return round(begins_utc_h * HOUR_NS)


def day_of(wall_ns: int, shift_ns: int) -> int:
    """Days since 1970-01-01 of a moment in ns since 1970, where days begin that long after UTC's midnight."""
    return (int(wall_ns) - shift_ns) // DAY_NS


def day_range_ns(day: int, shift_ns: int) -> tuple[int, int]:
    """From when to when (exclusive) that day lasts, ns since 1970."""
    start = day * DAY_NS + shift_ns
    return start, start + DAY_NS


def day_name(day: int) -> str:
    """As in file names: 2026-11-21. A clock far off is held at the years 1 and 9999."""
    return (_EPOCH + timedelta(days=max(-719162, min(day, 2932896)))).isoformat()
