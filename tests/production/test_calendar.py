"""Shifts, days and the timetable in local time, over the changes of the clocks too."""

from __future__ import annotations

from datetime import UTC, date, datetime, time
from itertools import pairwise
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.production.calendar import S_NS, find_instant_ns, open_zone, parse_clock
from beltscape.production.settings import (
    ProductionSettings,
    ProductSettings,
    ShiftSettings,
    TimetableSettings,
    check_products,
)
from beltscape.production.shifts import find_due_change, list_production_days, list_shifts

BERLIN, LORD_HOWE = ZoneInfo("Europe/Berlin"), ZoneInfo("Australia/Lord_Howe")
SHIFTS = tuple(
    ShiftSettings(name=name, begins=begins)
    for name, begins in (("early", "06:00"), ("late", "14:00"), ("night", "22:00"))
)


def utc_ns(*parts: int) -> int:
    return int(datetime(*parts, tzinfo=UTC).timestamp()) * S_NS


@pytest.mark.parametrize(
    ("day", "clock", "expected"),
    [
        (date(2026, 7, 1), "06:00", utc_ns(2026, 7, 1, 4)),
        (date(2026, 1, 1), "06:00", utc_ns(2026, 1, 1, 5)),
        (date(2026, 3, 29), "02:30", utc_ns(2026, 3, 29, 1)),  # skipped: when the clocks are set forward
        (date(2026, 3, 29), "03:00", utc_ns(2026, 3, 29, 1)),
        (date(2026, 10, 25), "02:30", utc_ns(2026, 10, 25, 0, 30)),  # shown twice: the first
    ],
)
def test_local_times_are_found(day: date, clock: str, expected: int) -> None:
    assert find_instant_ns(day, parse_clock(clock), BERLIN) == expected


def test_a_change_of_half_an_hour_is_found() -> None:
    skipped = find_instant_ns(date(2026, 10, 4), time(2, 15), LORD_HOWE)
    assert skipped == find_instant_ns(date(2026, 10, 4), time(2, 30), LORD_HOWE)


@given(
    day=st.dates(date(2000, 1, 1), date(2037, 12, 31)),
    one=st.times(),
    other=st.times(),
    zone=st.sampled_from(
        ["Europe/Berlin", "America/New_York", "Australia/Lord_Howe", "Asia/Shanghai", "UTC"]
    ),
)
def test_later_local_times_are_no_earlier_instants(day: date, one: time, other: time, zone: str) -> None:
    low, high = sorted(each.replace(second=0, microsecond=0, fold=0) for each in (one, other))
    opened = open_zone(zone)
    assert find_instant_ns(day, low, opened) <= find_instant_ns(day, high, opened)


def test_the_night_of_the_change_has_nine_hours_in_autumn_and_seven_in_spring() -> None:
    def hours(since_ns: int) -> dict[str, float]:
        found = list_shifts(SHIFTS, BERLIN, since_ns, since_ns + 36 * 3600 * S_NS)
        return {f"{p.day} {p.name}": (p.until_ns - p.since_ns) / 3600 / S_NS for p in found}

    autumn = hours(utc_ns(2026, 10, 24, 12))
    assert autumn["2026-10-24 night"] == 9.0
    assert autumn["2026-10-25 early"] == 8.0
    assert hours(utc_ns(2026, 3, 28, 12))["2026-03-28 night"] == 7.0


def test_shifts_meet_without_gap_over_a_year() -> None:
    found = list_shifts(SHIFTS, BERLIN, utc_ns(2026, 1, 1), utc_ns(2027, 1, 1))
    assert all(a.until_ns == b.since_ns for a, b in pairwise(found))
    assert len({period.key for period in found}) == len(found) == 3 * 365 + 1
    days = list_production_days(SHIFTS, BERLIN, utc_ns(2026, 1, 1, 6), utc_ns(2026, 1, 3, 4))
    assert [day.day.isoformat() for day in days] == ["2026-01-01", "2026-01-02"]


def test_one_shift_is_a_whole_day_and_none_are_no_shifts() -> None:
    (day, *_) = list_shifts(SHIFTS[:1], BERLIN, utc_ns(2026, 5, 5, 12), utc_ns(2026, 5, 5, 13))
    assert day.until_ns - day.since_ns == 24 * 3600 * S_NS
    assert list_shifts((), BERLIN, 0, utc_ns(2026, 1, 1)) == []


def test_the_timetable_names_the_newest_change() -> None:
    table = (
        TimetableSettings(at="06:00", product="coal"),
        TimetableSettings(at="14:00", product="ore", days=("mon",)),
    )

    def due(*parts: int) -> tuple[str, int] | None:
        found = find_due_change(table, BERLIN, utc_ns(*parts))
        return None if found is None else (found.product, found.wall_ns)

    assert due(2026, 11, 23, 4, 59) == ("coal", utc_ns(2026, 11, 22, 5))
    assert due(2026, 11, 23, 5, 0) == ("coal", utc_ns(2026, 11, 23, 5))
    assert due(2026, 11, 23, 20) == ("ore", utc_ns(2026, 11, 23, 13))
    assert due(2026, 11, 24, 20) == ("coal", utc_ns(2026, 11, 24, 5))
    assert find_due_change((), BERLIN, utc_ns(2026, 1, 1)) is None


def test_an_entry_of_one_day_holds_for_the_whole_week() -> None:
    table = (TimetableSettings(at="06:00", product="ore", days=("mon",)),)
    for day in range(23, 30):
        found = find_due_change(table, BERLIN, utc_ns(2026, 11, day, 5, 1))
        assert found is not None
        assert found.wall_ns == utc_ns(2026, 11, 23, 5)


@pytest.mark.parametrize(
    ("fields", "part"),
    [
        ({"time_zone": "Berlin"}, "no time zone"),
        ({"shifts": [{"name": "a", "begins": "6"}]}, "no time of day"),
        ({"shifts": [{"name": "a", "begins": "06:00"}, {"name": "b", "begins": "06:00"}]}, "given twice"),
        ({"timetable": [{"at": "25:00", "product": "x"}]}, "no time of day"),
    ],
)
def test_wrong_settings_are_refused(fields: dict[str, object], part: str) -> None:
    with pytest.raises(ValueError, match=part):
        ProductionSettings.model_validate(fields)


def test_products_that_are_not_there_are_named() -> None:
    coal = ProductSettings(name="coal", density_kg_m3=800)
    assert check_products((coal,), ProductionSettings(product="coal")) == ""
    assert "'ore'" in check_products((coal,), ProductionSettings(product="ore"))
    assert "given twice" in check_products((coal, coal), ProductionSettings())
    table = (TimetableSettings(at="06:00", product="ore"),)
    assert "timetable" in check_products((coal,), ProductionSettings(timetable=table))
