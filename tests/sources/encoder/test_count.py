"""Encoder counts as positions: wraps, resets and restarts."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.sources.encoder.settings import EncoderSettings
from beltscape.sources.encoder.track import CountUnwrapper
from tests.strategies import floats

STEP_NS = 10_000_000
SPEEDS = st.lists(floats(-200, 8000), min_size=1, max_size=60)
"""mm/s over the single steps of 10 ms."""


def settings(**values):
    return EncoderSettings(kind="udp", **values)


def travelled(speeds, start_mm=0.0):
    places = [start_mm]
    for speed in speeds:
        places.append(places[-1] + speed * STEP_NS * 1e-9)
    return places


def positions_of(count, raws, start_ns=0):
    return [count.position_mm(raw, start_ns + k * STEP_NS) for k, raw in enumerate(raws)]


@given(SPEEDS, floats(-1e6, 1e6), st.booleans())
def test_a_count_that_does_not_wrap_is_the_position(speeds, start_mm, reverse):
    places = travelled(speeds, start_mm)
    raws = [(-place if reverse else place) / 0.25 for place in places]
    count = CountUnwrapper(settings(mm_per_count=0.25, reverse=reverse))
    assert positions_of(count, raws) == pytest.approx(places, abs=1e-6)
    assert count.jumps == 0


@given(SPEEDS, floats(0, 1e9), st.sampled_from([16, 32]), st.booleans())
def test_wraps_are_removed(speeds, start_mm, bits, reverse):
    places = travelled(speeds, start_mm)
    counts = [round(place / 0.1) for place in places]
    raws = [(-value if reverse else value) % 2**bits for value in counts]
    count = CountUnwrapper(settings(mm_per_count=0.1, counter_bits=bits, reverse=reverse))
    positions = positions_of(count, raws)
    assert 0 <= positions[0] < 2**bits * 0.1
    exact = [value * 0.1 - counts[0] * 0.1 for value in counts]
    assert [place - positions[0] for place in positions] == pytest.approx(exact, abs=1e-3)
    assert count.jumps == 0


def test_a_fast_counter_is_followed_over_more_than_half_its_range():
    """4 m of 6.5536 m between readings: distinguished by the previous speed."""
    count = CountUnwrapper(settings(mm_per_count=0.1, counter_bits=16))
    places = [*range(0, 4000, 100), *range(4000, 40001, 4000)]
    times = [round(place / 4000 * 1e9) for place in places]
    positions = [
        count.position_mm(place * 10 % 65536, time) for place, time in zip(places, times, strict=True)
    ]
    assert positions == pytest.approx(places)


@given(SPEEDS, SPEEDS, floats(1e5, 1e6))
def test_reset_device_continues_at_its_position(before, after, start_mm):
    first = travelled(before, start_mm)
    second = travelled([max(speed, 0) for speed in after], 3.0)  # it counted 3 mm since its reset
    count = CountUnwrapper(settings())
    positions = positions_of(count, [*first, *second])
    assert count.jumps == 1
    expected = [first[-1] + place for place in second]
    assert positions[len(first) :] == pytest.approx(expected, abs=1e-6)


@given(SPEEDS, SPEEDS)
def test_after_a_restart_of_the_program_positions_are_the_same(before, after):
    """With what was kept: the device's own count, and the offset that a reset left."""
    first = [5e5, 5e5 + 10, *travelled([abs(v) for v in before], 2.0)]
    kept = CountUnwrapper(settings())
    end = positions_of(kept, first)[-1]
    second = travelled([abs(v) for v in after], first[-1])
    ongoing = [kept.position_mm(raw, 10**12 + k * STEP_NS) for k, raw in enumerate(second)]
    restarted = CountUnwrapper(settings(), kept.offset_mm, resume_mm=end)
    assert positions_of(restarted, second) == pytest.approx(ongoing, abs=1e-6)
    assert restarted.jumps == 0


@given(floats(3e3, 1e7), floats(-2990, 3540), st.sampled_from([16, 32]))
def test_wrapping_counter_continues_near_the_ledgers_end(end_mm, away_mm, bits):
    """Less than half a turn (6553.6 mm of 16 bit) passed while the program was away; the ledger was ahead."""
    raw = round((end_mm + away_mm) / 0.1) % 2**bits
    positions = CountUnwrapper(settings(mm_per_count=0.1, counter_bits=bits), resume_mm=end_mm).position_mm(
        raw, 0
    )
    assert positions == pytest.approx(end_mm + away_mm, abs=0.06)


def test_device_reset_between_runs_continues_at_the_ledgers_end():
    count = CountUnwrapper(settings(), resume_mm=80_000.0)
    assert positions_of(count, [20.0, 30.0]) == [80_000.0, 80_010.0]
    assert count.jumps == 1
    assert count.offset_mm == 79_980.0


def test_a_ledger_that_is_ahead_by_what_is_in_view_is_no_reset():
    count = CountUnwrapper(settings(), resume_mm=80_000.0)
    assert count.position_mm(78_000.0, 0) == 78_000.0
    assert count.jumps == 0


def test_travel_between_runs_is_counted():
    assert CountUnwrapper(settings(), resume_mm=80_000.0).position_mm(95_000.0, 0) == 95_000.0


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e15, max_value=1e15))
def test_wrong_reading_moves_the_belt_by_no_more_than_possible(wild):
    count = CountUnwrapper(settings())
    raws = [100_000.0 + 20 * k for k in range(10)]
    raws[5] = wild
    positions = positions_of(count, raws)
    assert abs(positions[-1] - raws[-1]) <= 12_000 * 1.0 + 100 + 20


@given(
    st.integers(1, 300), st.sampled_from([10, 100, 1000]), st.sampled_from([None, 16, 32]), floats(0, 6000)
)
def test_delayed_readings_are_travel(held, rate_hz, bits, speed):
    """The belt moves meanwhile; only the arrival gives the time."""
    held = min(held, 10 * rate_hz)
    counts = [round(speed / rate_hz * k / 0.1) for k in range(rate_hz + held + rate_hz)]
    step_ns = 10**9 // rate_hz
    late = (rate_hz + held) * step_ns
    count = CountUnwrapper(settings(mm_per_count=0.1, counter_bits=bits))
    positions = [
        count.position_mm(
            value if bits is None else value % 2**bits,
            late + k if rate_hz <= k < rate_hz + held else k * step_ns + (k >= rate_hz) * held,
        )
        for k, value in enumerate(counts)
    ]
    # whether a counter turned within the time without readings is anybody's guess
    if bits != 16 or speed * (held + 1) / rate_hz < 3000:
        assert positions == pytest.approx([0.1 * value for value in counts], abs=1e-6)
        assert count.jumps == 0


def test_readings_out_of_order_are_no_jumps():
    count = CountUnwrapper(settings())
    assert positions_of(count, [0.0, 600.0, 200.0, 400.0, 800.0]) == [0.0, 600.0, 200.0, 400.0, 800.0]
    assert count.jumps == 0


def test_a_long_silence_is_no_jump():
    count = CountUnwrapper(settings())
    positions_of(count, [0.0, 20.0])
    assert count.position_mm(600_000.0, 300_000_000_000) == 600_000.0
    assert count.jumps == 0


def test_running_backwards_is_reported_and_rolling_back_is_not():
    count = CountUnwrapper(settings())
    positions_of(count, [10_000.0, 9_900.0, 9_800.0])
    assert count.back_mm == 0
    places = [count.position_mm(10_000.0 - 100 * k, k * STEP_NS) for k in range(3, 20)]
    assert places[-1] == 8_100.0
    assert count.back_mm == 1_900.0
