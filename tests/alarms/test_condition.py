"""The condition of one alarm: limits with hysteresis and σ."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.state_machine import (
    AlarmCondition,
    compare_lower,
    compare_upper,
    condition_from_text,
    select_worst,
)
from tests.strategies import floats

RANK = {"off": 0, "between": 1, "on": 2}
LIMITS = floats(1e-3, 1e6)
SHARES = floats(0.01, 1.0)


@given(LIMITS, SHARES, floats(0, 1e3), floats(0, 5), floats(0, 1))
def test_value_within_the_band_is_between(limit, hysteresis, sigma, sigmas, place):
    clear = limit * (1 - hysteresis)
    top = limit + sigmas * sigma
    value = clear + place * (top - clear)
    assert compare_upper(value, sigma, limit, hysteresis, sigmas) in (
        "between",
        "off" if value <= clear else "between",
    )
    if clear < value <= limit:
        assert compare_upper(value, sigma, limit, hysteresis, sigmas) == "between"


@given(LIMITS, SHARES, floats(0, 1e3), floats(0, 5), floats(-1e6, 1e6), floats(-1e6, 1e6))
def test_condition_is_monotonic_in_the_value(limit, hysteresis, sigma, sigmas, one, two):
    low, high = sorted((one, two))
    conditions = [compare_upper(value, sigma, limit, hysteresis, sigmas) for value in (low, high)]
    assert RANK[conditions[0]] <= RANK[conditions[1]]
    conditions = [compare_lower(value, sigma, limit, hysteresis, sigmas) for value in (high, low)]
    assert RANK[conditions[0]] <= RANK[conditions[1]]


@given(LIMITS, SHARES, floats(-1e6, 1e6), floats(0, 1e3), floats(0, 1e3))
def test_larger_sigma_never_raises_and_never_prevents_clearing(limit, hysteresis, value, one, two):
    small, large = (compare_upper(value, sigma, limit, hysteresis, 1.0) for sigma in sorted((one, two)))
    assert RANK[large] <= RANK[small]
    assert (large == "off") == (small == "off")


@given(st.sampled_from([math.nan, math.inf, -math.inf]), floats(0, 5))
def test_value_that_is_not_finite_is_unknown(value, sigmas):
    assert compare_upper(value, 1, 5, 0.1, sigmas) == compare_lower(value, 1, 5, 0.1, sigmas) == "unknown"


@pytest.mark.parametrize("sigmas", [0.0, 1.0])
def test_unknown_sigma_counts_as_zero(sigmas):
    assert compare_upper(10.01, math.nan, 10, 0.1, sigmas) == "on"
    assert compare_upper(8.9, math.nan, 10, 0.1, sigmas) == "off"


def test_infinite_sigma_never_raises():
    assert compare_upper(1e9, math.inf, 10, 0.1, 1.0) == "between"
    assert compare_upper(1e9, math.inf, 10, 0.1, 0.0) == "on"


@given(st.lists(st.sampled_from(["on", "off", "between", "unknown"]), min_size=1, max_size=4))
def test_several_limits_are_on_by_any_and_off_by_all(conditions):
    state = select_worst([AlarmCondition(condition) for condition in conditions]).state
    assert (state == "on") == ("on" in conditions)
    assert (state == "off") == (set(conditions) == {"off"})


def test_condition_without_a_limit_is_unknown():
    assert select_worst([]).state == "unknown"


def test_condition_from_text_is_on_with_a_text():
    assert [condition_from_text(text).state for text in (None, "", "disk is full")] == [
        "unknown",
        "off",
        "on",
    ]
    assert condition_from_text("disk is full").text == "disk is full"
