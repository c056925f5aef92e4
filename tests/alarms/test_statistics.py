"""Key figures of the alarm system: rates, floods, chattering, stale and frequent alarms."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.statistics import FLOOD_BEGINS, FLOOD_ENDS, WINDOW_NS, Annunciation, compute_statistics
from beltscape.core.alarms import Alarm

MINUTE_NS = 60_000_000_000
NAN = float("nan")


def at(*minutes: float, name: str = "overload") -> list[Annunciation]:
    return [Annunciation(round(minute * MINUTE_NS), name, "high") for minute in minutes]


def test_an_empty_period_has_no_alarm():
    found = compute_statistics([], 0, 60 * MINUTE_NS)
    assert (found.count, found.mean_per_10_min, found.peak_per_10_min, found.floods, found.top) == (
        0,
        0,
        0,
        0,
        (),
    )
    assert math.isnan(compute_statistics([], 5, 5).mean_per_10_min)


def test_rates_and_the_most_frequent():
    raised = at(1, 2, 55) + at(56, name="camera_lost:cam2") + at(70)
    found = compute_statistics(raised, 0, 60 * MINUTE_NS)
    assert (found.count, found.last_10_min, found.peak_per_10_min) == (4, 2, 2)
    assert abs(found.mean_per_10_min - 4 / 6) < 1e-12
    assert [(one.name, one.count, one.share) for one in found.top] == [
        ("overload", 3, 0.75),
        ("camera_lost:cam2", 1, 0.25),
    ]
    assert found.by_priority == {"low": 0, "medium": 0, "high": 4, "urgent": 0}


def test_a_flood_begins_above_ten_and_ends_below_five():
    raised = at(*(20 + 0.5 * i for i in range(11)))  # the eleventh at 25 min; the seventh leaves at 33 min
    found = compute_statistics(raised, 0, 100 * MINUTE_NS)
    assert (found.floods, found.peak_per_10_min, found.is_flood) == (1, 11, False)
    assert abs(found.flood_share - 0.08) < 1e-12
    assert compute_statistics(at(*(20 + 0.5 * i for i in range(10))), 0, 100 * MINUTE_NS).floods == 0
    assert compute_statistics(raised, 0, 30 * MINUTE_NS).is_flood


def test_chattering_is_three_times_in_a_minute():
    steady, chatter = at(1, 1.6, 2.2, 2.8), at(5, 5.4, 5.9, name="empty")
    assert compute_statistics(steady + chatter, 0, 60 * MINUTE_NS).chattering == ("empty",)


def test_stale_alarms_stand_for_more_than_a_day():
    day = 24 * 60 * MINUTE_NS
    present = [
        Alarm("old", "warning", "acknowledged", NAN, NAN, "", 1),
        Alarm("new", "warning", "raised", NAN, NAN, "", day),
        Alarm("none", "warning", "clear", NAN, NAN, "", None),
    ]
    assert compute_statistics([], 0, day + 2 * MINUTE_NS, present).stale == ("old",)


@given(st.lists(st.integers(0, 200), max_size=80))
def test_floods_agree_with_a_count_at_every_minute(minutes):
    end = 220
    found = compute_statistics(at(*minutes), 0, end * MINUTE_NS)
    times = sorted(minute * MINUTE_NS for minute in minutes)
    flooded, is_flood, starts, peak = 0, False, 0, 0
    for minute in range(end):
        now = minute * MINUTE_NS
        before = sum(now - WINDOW_NS < time < now for time in times)
        count = sum(now - WINDOW_NS < time <= now for time in times)
        peak = max(peak, count)
        if is_flood and before < FLOOD_ENDS:
            is_flood = False
        if not is_flood and count > FLOOD_BEGINS:
            is_flood, starts = True, starts + 1
        flooded += is_flood
    assert (found.floods, found.peak_per_10_min) == (starts, peak)
    assert abs(found.flood_share * end - flooded) < 1e-9
