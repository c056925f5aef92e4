"""Shifts and production days as periods between instants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, time
from itertools import pairwise
from typing import Literal
from zoneinfo import ZoneInfo

from beltscape.production.calendar import find_instant_ns, find_local, list_days, parse_clock
from beltscape.production.settings import ShiftSettings

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
