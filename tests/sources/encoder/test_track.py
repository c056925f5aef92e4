"""Positions of the belt between and after readings."""

from __future__ import annotations

import math
from threading import Thread, Timer
from time import monotonic_ns

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.sources.encoder.readings import DeviceClock
from beltscape.sources.encoder.track import PositionTrack
from tests.optional import require
from tests.strategies import floats

MS = 1_000_000
GAPS = st.lists(st.integers(1, 90), min_size=1, max_size=40)


def track(readings, silent_ms=100):
    out = PositionTrack(silent_ms * MS)
    for time_ms, position in readings:
        out.add(round(time_ms * MS), position)
    return out


@given(GAPS, floats(-10, 10), floats(-1e6, 1e6), floats(0, 1))
def test_position_at_constant_speed_is_exact(gaps, speed, start, place):
    times = [sum(gaps[:k]) for k in range(len(gaps) + 1)]
    found = track([(t, start + speed * t) for t in times])
    time_ns = round(place * times[-1] * MS)
    assert found.position_at(time_ns) == pytest.approx(start + speed * time_ns / MS, abs=1e-6)


@given(GAPS, st.data())
def test_position_lies_between_its_neighbours(gaps, data):
    times = [sum(gaps[:k]) for k in range(len(gaps) + 1)]
    steps = data.draw(st.lists(floats(0, 50), min_size=len(times), max_size=len(times)))
    places = [sum(steps[: k + 1]) for k in range(len(times))]
    found = track(zip(times, places, strict=True))
    times_ms = sorted(data.draw(st.lists(floats(0, times[-1]), min_size=1, max_size=20)))
    positions = [require(found.position_at(round(t * MS))) for t in times_ms]
    assert positions == sorted(positions)
    assert places[0] <= positions[0] <= positions[-1] <= places[-1]


def test_position_before_the_first_reading_is_unknown():
    assert PositionTrack(MS).position_at(5) is None
    assert track([(10, 1.0), (20, 2.0)]).position_at(10 * MS - 1) is None
    assert track([(10, 1.0)]).position_at(10 * MS) == 1.0
    assert track([(10, 1.0)]).position_at(11 * MS) is None


def test_position_within_a_gap_is_unknown():
    found = track([(0, 0.0), (10, 1.0), (200, 2.0), (210, 3.0)])
    assert [found.position_at(t * MS) for t in (10, 11, 199, 200, 205)] == [1.0, None, None, 2.0, 2.5]


def test_track_is_extrapolated_for_twice_its_last_interval():
    found = track([(0, 0.0), (10, 1.0)])
    assert found.position_at(30 * MS) == pytest.approx(3.0)
    assert found.position_at(30 * MS + 1) is None
    slow = track([(0, 0.0), (90, 9.0)])
    assert slow.position_at(190 * MS) == pytest.approx(19.0)
    assert slow.position_at(190 * MS + 1) is None


def test_reading_that_is_not_later_replaces_the_last():
    found = track([(0, 0.0), (10, 1.0), (10, 2.0), (9, 3.0)])
    assert found.position_at(10 * MS) == 3.0
    assert found.position_at(5 * MS) == 1.5


def test_memory_is_bounded_and_the_newest_are_kept():
    found = track((k, float(k)) for k in range(100_000))
    assert found.position_at(99_999 * MS) == 99_999.0
    assert found.position_at(81_000 * MS) == 81_000.0
    assert found.position_at(50_000 * MS) is None


def test_a_frame_waits_for_the_reading_after_it():
    now = monotonic_ns()
    found = PositionTrack(1_000 * MS)
    found.add(now - 20 * MS, 0.0)
    found.add(now - 10 * MS, 1.0)
    later = Timer(0.02, found.add, (now + 10 * MS, 2.0))
    later.start()
    assert found.position_at(now, wait_ns=5_000 * MS) == pytest.approx(1.5)
    later.join()


def test_silent_or_closed_track_is_not_waited_for():
    silent = track([(0, 0.0), (10, 1.0)])
    start_ns = monotonic_ns()
    assert silent.position_at(monotonic_ns(), wait_ns=5_000 * MS) is None
    active = PositionTrack(10_000 * MS)
    active.add(start_ns, 0.0)
    waiting = Thread(target=active.position_at, args=(start_ns + 1, 60_000 * MS))
    waiting.start()
    active.close()
    waiting.join(2)
    assert not waiting.is_alive()
    assert monotonic_ns() - start_ns < 2_000 * MS


@given(st.lists(st.integers(0, 50), min_size=2, max_size=60), st.integers(-(10**12), 10**12))
def test_device_clock_follows_its_fastest_message(delays, apart_ms):
    clock = DeviceClock()
    for k, delay in enumerate(delays):
        true_ns = (1_000_000 + 10 * k) * MS
        found = clock.steady_ns(true_ns + apart_ms * MS, true_ns + delay * MS)
        assert found is not None
        assert found <= true_ns + delay * MS
        assert found - true_ns == min(delays[: k + 1]) * MS


def test_drifting_device_clock_is_tracked():
    clock = DeviceClock()
    true_ns, found = 0, None
    for k in range(200_000):
        true_ns = k * 10 * MS
        found = clock.steady_ns(round(true_ns * (1 + 1e-4)) + 10**15, true_ns)
    assert abs(require(found) - true_ns) < 2.1 * MS


def test_messages_out_of_order_are_skipped_and_a_clock_set_back_is_estimated_anew():
    clock = DeviceClock()
    assert clock.steady_ns(5_000 * MS, 100 * MS) == 100 * MS
    assert clock.steady_ns(4_990 * MS, 101 * MS) is None
    assert clock.steady_ns(1_000 * MS, 110 * MS) == 110 * MS
    assert clock.steady_ns(1_010 * MS, 125 * MS) == 120 * MS
    assert not math.isnan(require(clock.steady_ns(9_000_000 * MS, 130 * MS)))


def test_clock_set_forward_is_estimated_anew():
    clock = DeviceClock()
    clock.steady_ns(5_000 * MS, 100 * MS)
    assert clock.steady_ns(90_000 * MS, 110 * MS) == 110 * MS
