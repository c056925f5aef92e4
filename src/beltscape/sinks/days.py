"""Assignment of times to days that begin at a set hour."""

from __future__ import annotations

from datetime import date, timedelta

HOUR_NS = 3_600_000_000_000
"""Nanoseconds of an hour."""
DAY_NS = 24 * HOUR_NS
"""Nanoseconds of a day; days are those of UTC plus a fixed shift, so all are equally long."""
_EPOCH = date(1970, 1, 1)
"""Day 0, that of Unix time."""
_FIRST, _LAST = (date.min - _EPOCH).days, (date.max - _EPOCH).days
"""Days of the years 1 and 9999, which Python's dates and file names can hold."""


def compute_shift_ns(begins_utc_h: float) -> int:
    """Return the time from UTC's midnight to the beginning of a day."""
    return round(begins_utc_h * HOUR_NS)


def compute_day(wall_ns: int, shift_ns: int) -> int:
    """Return the day (days since 1970) of a time in ns since 1970; days begin ``shift_ns`` after midnight UTC."""
    return (int(wall_ns) - shift_ns) // DAY_NS


def compute_day_range_ns(day: int, shift_ns: int) -> tuple[int, int]:
    """Return the beginning and the end (exclusive) of a day, ns since 1970."""
    start = day * DAY_NS + shift_ns
    return start, start + DAY_NS


def format_day(day: int) -> str:
    """Return a day's name as in file names, such as 2026-11-21; years are limited to 1 to 9999."""
    return (_EPOCH + timedelta(days=max(_FIRST, min(day, _LAST)))).isoformat()
