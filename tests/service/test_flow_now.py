"""The current flow and its trend."""

from __future__ import annotations

from dataclasses import replace
from math import isnan, nan

import pytest

from beltscape.core.ledger import BeltRecord, FlowRecord, Standing
from beltscape.service.view_models import FlowAverage


def make_record(
    volume_mm3: float, *, standing: Standing = "valid", length=200.0, speed=2000.0, density=1600.0
) -> BeltRecord:
    strip = None
    if standing != "missing":
        strip = FlowRecord(
            "f", None, 0, (0, length), volume_mm3 / length, volume_mm3, volume_mm3 * 0.01, speed, density, 0.9, 0.8,
            "measured",
        )  # fmt: skip
    return BeltRecord(1, 1, (0.0, length), standing, "", 0, strip, 0.0, 5, None)


def test_flow_is_volume_over_time():
    flow = FlowAverage(1.0)
    flow.add([make_record(1e7)] * 5 + [make_record(2e7)] * 10)  # each 0.1 s: the last second holds 2e7 only
    now = flow.compute(2000.0)
    assert now.volume_m3_h == pytest.approx(2e7 / 0.1 * 3600e-9)
    assert now.sigma_m3_h == pytest.approx(0.01 * now.volume_m3_h)
    assert now.mass_t_h == pytest.approx(1.6 * now.volume_m3_h)
    assert now.mass_sigma_t_h == pytest.approx(0.01 * now.mass_t_h)
    assert now.area_mm2 == pytest.approx(2e7 / 200)
    assert now.coverage == pytest.approx(0.9)
    assert now.standing == "valid"


def test_unmeasured_belt_is_not_taken_for_empty():
    flow = FlowAverage(1.0)
    flow.add([make_record(1e7)] * 5 + [make_record(0, standing="missing")] * 5)
    now = flow.compute(2000.0)
    assert now.volume_m3_h == pytest.approx(1e7 / 0.1 * 3600e-9)
    assert now.standing == "missing"
    flow.add([make_record(0, standing="missing")] * 30)
    assert isnan(flow.compute(2000.0).volume_m3_h)


def test_a_stopped_belt_has_no_flow_and_an_unknown_speed_keeps_it():
    flow = FlowAverage(1.0)
    assert isnan(flow.compute(nan).volume_m3_h)
    flow.add([make_record(1e7)] * 20)
    assert flow.compute(0.0).volume_m3_h == 0
    assert flow.compute(nan).volume_m3_h > 0


def test_a_flow_without_a_new_measured_record_is_unknown():
    now_s = 100.0
    flow = FlowAverage(1.0, monotonic_s=lambda: now_s)
    assert isnan(flow.compute(0.0).volume_m3_h)  # nothing measured yet
    flow.add([make_record(1e7)] * 20)
    now_s = 102.9
    assert flow.compute(2000.0).volume_m3_h > 0
    flow.add([make_record(0, standing="missing")])
    now_s = 103.1
    assert isnan(flow.compute(2000.0).volume_m3_h)
    assert isnan(flow.compute(0.0).volume_m3_h)
    flow.add([make_record(1e7, standing="degraded")])
    assert flow.compute(0.0).standing == "degraded"


def test_mass_flow_is_nan_without_a_density():
    flow = FlowAverage(1.0)
    flow.add([make_record(1e7, density=nan)] * 20)
    assert isnan(flow.compute(2000.0).mass_t_h)
    assert flow.compute(2000.0).volume_m3_h > 0


@pytest.mark.parametrize(
    ("last", "trend"), [(1e7, "steady"), (1.02e7, "steady"), (1.3e7, "rising"), (0.7e7, "falling")]
)
def test_trend_compares_with_the_minute_before(last, trend):
    flow = FlowAverage(1.0)
    flow.add([make_record(1e7)] * 30)
    assert flow.compute(2000.0).trend == "unknown"
    flow.add([make_record(1e7)] * 300 + [make_record(last)] * 10)
    assert flow.compute(2000.0).trend == trend


def test_memory_is_bounded():
    flow = FlowAverage(1.0)
    flow.add([make_record(1e7)] * 5000)
    assert len(flow._strips) <= 700


def test_records_that_no_camera_has_seen_keep_no_flow_alive():
    now = [0.0]
    flow = FlowAverage(1.0, monotonic_s=lambda: now[0])
    flow.add([make_record(1e7)] * 20)
    assert flow.compute(2000.0).age_s == 0
    for _ in range(40):
        now[0] += 0.1
        unseen = replace(make_record(1e7, standing="degraded"), cameras=0)
        strip = unseen.strip
        assert strip is not None
        flow.add([unseen, replace(unseen, cameras=5, strip=replace(strip, coverage=0.0))])
    old = flow.compute(2000.0)
    assert isnan(old.volume_m3_h) and old.standing == "missing" and old.age_s == pytest.approx(4.0)
    assert isnan(flow.compute(0.0).volume_m3_h)  # nor is a stopped belt's 0 shown
