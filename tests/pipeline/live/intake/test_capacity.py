"""The capacity of the computer: what it can measure in a second, and the belt speed that this suffices for."""

from __future__ import annotations

import math

import pytest

from beltscape.core.events import Capacity
from beltscape.pipeline.live.gauges import CapacityMeter

WINDOW_MM = 600.0


def test_it_is_unknown_until_some_frame_sets_were_measured() -> None:
    meter = CapacityMeter(None)
    for _ in range(4):
        meter.add(0.5, 0.1)
        assert math.isnan(meter.compute(WINDOW_MM).sets_per_s)
    meter.add(0.5, 0.1)
    assert meter.compute(WINDOW_MM) == Capacity(2.0, 600.0)


def test_slow_first_frame_sets_do_not_count() -> None:
    meter = CapacityMeter(None)
    for elapsed_s in (9.0, 7.0, 0.5, 0.5, 0.5):
        meter.add(elapsed_s, 0.1)
    assert meter.compute(WINDOW_MM).sets_per_s == 2


@pytest.mark.parametrize(("own_s", "matched_per_s", "expected"), [(0.1, 4.0, 4.0), (0.5, 8.0, 2.0)])
def test_workers_or_this_process_limit_it(own_s: float, matched_per_s: float, expected: float) -> None:
    meter = CapacityMeter(lambda: matched_per_s)
    for _ in range(5):
        meter.add(3.0, own_s)
    capacity = meter.compute(WINDOW_MM)
    assert capacity.sets_per_s == pytest.approx(expected)
    assert capacity.speed_mm_s == pytest.approx(expected * 300)
