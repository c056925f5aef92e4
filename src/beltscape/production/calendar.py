"""Local times of a day as instants: exact over the change to and from summer time."""

from __future__ import annotations

import re
from datetime import UTC, date, datetime, time, timedelta
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

S_NS = 1_000_000_000
"""Nanoseconds of a second."""
_CLOCK = re.compile(r"([01]\d|2[0-3]):([0-5]\d)")
_MINUTE_S = 60
"""Seconds of a minute, the resolution of a change of the clocks."""


def open_zone(name: str) -> ZoneInfo:
    """Return the time zone of that IANA name; ValueError if there is none."""
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError) as error:
        raise ValueError(
            f"{name!r} is no time zone of the IANA database; write one such as Europe/Berlin or UTC"
        ) from error


def parse_clock(text: str) -> time:
    """Return the time of day of a text such as "06:00"; ValueError for any other."""
    match = _CLOCK.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is no time of day; write hours and minutes, such as 06:00")
    return time(int(match[1]), int(match[2]))


def find_instant_ns(day: date, clock: time, zone: ZoneInfo) -> int:
    """Return a local time of a day, ns since 1970.

    A time that the clocks skip is the instant at which they do; one that they show twice is the first of both
    (PEP 495).
    """
    local = datetime.combine(day, clock)
    early, late = (round(local.replace(tzinfo=zone, fold=fold).timestamp()) for fold in (1, 0))
    if early < late:  # skipped: before the change by the later offset, after it by the earlier one
        while late - early > _MINUTE_S:
            middle = (early + late) // (2 * _MINUTE_S) * _MINUTE_S
            is_before = find_local(middle * S_NS, zone).replace(tzinfo=None) < local
            early, late = (middle, late) if is_before else (early, middle)
    return late * S_NS


def find_local(wall_ns: int, zone: ZoneInfo) -> datetime:
    """Return an instant as local time, to the second."""
    return datetime.fromtimestamp(wall_ns // S_NS, UTC).astimezone(zone)


def list_days(since_ns: int, until_ns: int, zone: ZoneInfo) -> list[date]:
    """Return the local days that touch a period, and one more on either side."""
    first = find_local(since_ns, zone).date() - timedelta(days=1)
    last = find_local(until_ns, zone).date() + timedelta(days=1)
    return [first + timedelta(days=number) for number in range((last - first).days + 1)]
