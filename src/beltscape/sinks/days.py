"""Which day a moment belongs to."""

from __future__ import annotations

from datetime import date, timedelta

HOUR_NS = 3_600_000_000_000
DAY_NS = 24 * HOUR_NS
_EPOCH = date(1970, 1, 1)


def day_of(wall_ns: int, begins_utc_h: float) -> int:
    """Days since 1970-01-01 of a moment in ns since 1970, where days begin at that hour of UTC."""
    return (wall_ns - round(begins_utc_h * HOUR_NS)) // DAY_NS


def day_range_ns(day: int, begins_utc_h: float) -> tuple[int, int]:
    """From when to when (exclusive) that day lasts, ns since 1970."""
    start = day * DAY_NS + round(begins_utc_h * HOUR_NS)
    return start, start + DAY_NS


def day_name(day: int) -> str:
    """As in file names: 2026-11-21. A clock far off is held at the years 1 and 9999."""
    return (_EPOCH + timedelta(days=max(-719162, min(day, 2932896)))).isoformat()


def day_number(name: str) -> int:
    """Of a name as ``day_name`` gives; ValueError where it is none."""
    return (date.fromisoformat(name) - _EPOCH).days
