"""Shifts and production days as periods between instants, and the product that the timetable makes present."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, time
from itertools import pairwise
from typing import Literal
from zoneinfo import ZoneInfo

from beltscape.production.calendar import S_NS, find_instant_ns, find_local, list_days, parse_clock
from beltscape.production.settings import WEEKDAYS, ShiftSettings, TimetableSettings

PeriodKind = Literal["shift", "day"]


@dataclass(frozen=True, slots=True)
class Period:
    """A shift or a day, from its begin to before its end."""

    kind: PeriodKind
    name: str
    """Name of the shift; empty for a day."""
    day: date
    """Local day on which it begins."""
    since_ns: int
    """System clock, ns since 1970."""
    until_ns: int

    @property
    def key(self) -> str:
        """Return its name in files and addresses: its begin in UTC and its kind."""
        return f"{find_local(self.since_ns, ZoneInfo('UTC')):%Y%m%dT%H%MZ}_{self.kind}"


def list_shifts(
    shifts: Sequence[ShiftSettings], zone: ZoneInfo, since_ns: int, until_ns: int
) -> list[Period]:
    """Return the shifts that touch a period, oldest first; one ends where the next begins.

    A shift over the change to or from summer time is an hour shorter or longer; one that the clocks skip is left out.
    """
    begins = sorted(
        ((find_instant_ns(day, parse_clock(shift.begins), zone), day, shift.name) for shift in shifts
         for day in list_days(since_ns, until_ns, zone)),
        key=lambda begin: begin[0],
    )  # fmt: skip
    periods = [Period("shift", name, day, begin, end) for (begin, day, name), (end, _, _) in pairwise(begins)]
    return [p for p in periods if p.since_ns < until_ns and p.until_ns > since_ns and p.until_ns > p.since_ns]


def list_production_days(
    shifts: Sequence[ShiftSettings], zone: ZoneInfo, since_ns: int, until_ns: int
) -> list[Period]:
    """Return the days that touch a period, oldest first; they begin with the first shift, without shifts at 00:00."""
    clock = parse_clock(shifts[0].begins) if shifts else time(0)
    begins = [(find_instant_ns(day, clock, zone), day) for day in list_days(since_ns, until_ns, zone)]
    periods = [Period("day", "", day, begin, end) for (begin, day), (end, _) in pairwise(begins)]
    return [period for period in periods if period.since_ns < until_ns and period.until_ns > since_ns]


_WEEK_NS = 8 * 86_400 * S_NS
"""More than a week: every entry is due at least once in it."""


@dataclass(frozen=True, slots=True)
class DueChange:
    """A change of the timetable whose time has come."""

    wall_ns: int
    product: str


def find_due_change(entries: Sequence[TimetableSettings], zone: ZoneInfo, wall_ns: int) -> DueChange | None:
    """Return the newest change at or before an instant; None for an empty timetable.

    Of several at one instant the last of the table counts.
    """
    due: DueChange | None = None
    for day in list_days(wall_ns - _WEEK_NS, wall_ns, zone) if entries else ():
        for entry in entries:
            if WEEKDAYS[day.weekday()] not in entry.days:
                continue
            at_ns = find_instant_ns(day, parse_clock(entry.at), zone)
            if at_ns <= wall_ns and (due is None or at_ns >= due.wall_ns):
                due = DueChange(at_ns, entry.product)
    return due
