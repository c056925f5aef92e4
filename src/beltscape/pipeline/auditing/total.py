"""A total by its name: everything, a batch, a day, or a period of time."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import Literal
from zoneinfo import ZoneInfo

from beltscape.core.errors import InputError
from beltscape.production.calendar import open_zone
from beltscape.production.settings import ShiftSettings
from beltscape.production.shifts import list_production_days
from beltscape.sinks.historian.day_files import UNBOUNDED

FORMS = "all, batch:17, day:2026-11-21, year:2026 or 2026-11-21T08:00Z/2026-11-21T09:00Z"
_DAY_NS = 86_400 * 10**9
"""Nanoseconds of a day."""


@dataclass(frozen=True, slots=True)
class TotalName:
    """What is to be explained."""

    kind: Literal["all", "batch", "period"]
    text: str
    """As it was given."""
    since_ns: int = -UNBOUNDED
    until_ns: int = UNBOUNDED
    """System clock, the end excluded; of a batch: unbounded."""
    batch: int = 0


def parse_total(text: str, zone: str = "UTC", shifts: tuple[ShiftSettings, ...] = ()) -> TotalName:
    """Return the total of a text; a day is that of the production, which begins with the first shift.

    Raises
    ------
    InputError
        With the forms that there are.
    """
    if text == "all":
        return TotalName("all", text)
    if found := re.fullmatch(r"batch:(\d{1,15})", text):
        return TotalName("batch", text, batch=int(found[1]))
    try:
        if text.startswith("day:"):
            return _find_days(text, text.removeprefix("day:"), 1, zone, shifts)
        if found := re.fullmatch(r"year:(\d{4})", text):
            year = int(found[1])
            days = (date(year + 1, 1, 1) - date(year, 1, 1)).days
            return _find_days(text, f"{year:04d}-01-01", days, zone, shifts)
        if text.count("/") == 1:
            since, until = (_parse_instant(part) for part in text.split("/"))
            if since >= until:
                raise InputError(f"{text}: ends before it begins; exchange both")
            return TotalName("period", text, since, until)
    except ValueError as error:
        raise InputError(f"{text}: {error}; give {FORMS}") from error
    raise InputError(f"{text}: is no total; give {FORMS}")


def _parse_instant(text: str) -> int:
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        raise ValueError(f"{text} has no offset from UTC, such as Z or +01:00")
    return round(moment.timestamp() * 1e6) * 1000


def _find_days(text: str, first: str, count: int, zone: str, shifts: tuple[ShiftSettings, ...]) -> TotalName:
    """Return the period of ``count`` production days from ``first`` on."""
    place, begin = open_zone(zone), date.fromisoformat(first)
    ends = [_find_begin(day, place, shifts) for day in (begin, begin + timedelta(days=count))]
    return TotalName("period", text, *ends)


def _find_begin(day: date, place: ZoneInfo, shifts: tuple[ShiftSettings, ...]) -> int:
    middle = int(datetime(day.year, day.month, day.day, 12, tzinfo=place).timestamp()) * 10**9
    days = list_production_days(shifts, place, middle - 2 * _DAY_NS, middle + 2 * _DAY_NS)
    return next(one.since_ns for one in days if one.day == day)
