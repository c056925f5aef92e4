"""The timetable: which product a regular change makes the present one, and when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from zoneinfo import ZoneInfo

from beltscape.production.calendar import S_NS, find_instant_ns, list_days, parse_clock
from beltscape.production.settings import WEEKDAYS, TimetableSettings

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
