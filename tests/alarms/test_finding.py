from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.finding import Finding, above, below, told, worst
from strategies import floats

RANK = {"off": 0, "between": 1, "on": 2}
LIMITS = floats(1e-3, 1e6)
SHARES = floats(0.01, 1.0)


@given(LIMITS, SHARES, floats(0, 1e3), floats(0, 5), floats(0, 1))
def test_within_the_band_nothing_is_said(limit, hysteresis, sigma, sigmas, place):
    clear = limit * (1 - hysteresis)
    top = limit + sigmas * sigma
    value = clear + place * (top - clear)
    assert above(value, sigma, limit, hysteresis, sigmas) in (
        "between",
        "off" if value <= clear else "between",
    )
    if clear < value <= limit:
        assert above(value, sigma, limit, hysteresis, sigmas) == "between"


@given(LIMITS, SHARES, floats(0, 1e3), floats(0, 5), floats(-1e6, 1e6), floats(-1e6, 1e6))
def test_more_is_never_less_of_an_alarm(limit, hysteresis, sigma, sigmas, one, two):
    low, high = sorted((one, two))
    conditions = [above(value, sigma, limit, hysteresis, sigmas) for value in (low, high)]
    assert RANK[conditions[0]] <= RANK[conditions[1]]
    conditions = [below(value, sigma, limit, hysteresis, sigmas) for value in (high, low)]
    assert RANK[conditions[0]] <= RANK[conditions[1]]


@given(LIMITS, SHARES, floats(-1e6, 1e6), floats(0, 1e3), floats(0, 1e3))
def test_a_larger_sigma_never_raises_and_never_hinders_clearing(limit, hysteresis, value, one, two):
    small, large = (above(value, sigma, limit, hysteresis, 1.0) for sigma in sorted((one, two)))
    assert RANK[large] <= RANK[small]
    assert (large == "off") == (small == "off")


@given(st.sampled_from([math.nan, math.inf, -math.inf]), floats(0, 5))
def test_what_is_no_number_is_not_known(value, sigmas):
    assert above(value, 1, 5, 0.1, sigmas) == below(value, 1, 5, 0.1, sigmas) == "unknown"


@pytest.mark.parametrize("sigmas", [0.0, 1.0])
def test_a_sigma_that_is_not_known_counts_as_none(sigmas):
    assert above(10.01, math.nan, 10, 0.1, sigmas) == "on"
    assert above(8.9, math.nan, 10, 0.1, sigmas) == "off"


def test_an_endless_sigma_never_raises():
    assert above(1e9, math.inf, 10, 0.1, 1.0) == "between"
    assert above(1e9, math.inf, 10, 0.1, 0.0) == "on"


@given(st.lists(st.sampled_from(["on", "off", "between", "unknown"]), min_size=1, max_size=4))
def test_several_limits(conditions):
    told_by = worst([Finding(condition) for condition in conditions]).condition
    assert (told_by == "on") == ("on" in conditions)
    assert (told_by == "off") == (set(conditions) == {"off"})


def test_without_a_limit_nothing_is_known():
    assert worst([]).condition == "unknown"


def test_a_trouble_in_words():
    assert [told(text).condition for text in (None, "", "disk is full")] == ["unknown", "off", "on"]
    assert told("disk is full").said == "disk is full"
