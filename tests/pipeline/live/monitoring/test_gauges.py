"""The values that alarms are evaluated on: each has an age."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from beltscape.core.findings import Finding
from beltscape.core.ledger import BeltRecord, FlowRecord, Standing
from beltscape.pipeline.live import gauges as module
from beltscape.pipeline.live.gauges import Gauges

NAN = float("nan")


def make_entry(standing: Standing) -> BeltRecord:
    strip = FlowRecord("f", None, 0, (0, 100.0), 2e4, 2e6, 1e4, 600.0, 1600.0, 0.9, 0.8, "measured")
    return BeltRecord(1, 1, (0.0, 100.0), standing, "", 0, strip, 0.0, 5, None)


MEASURED: Any = SimpleNamespace(coverage=0.9)
"""Stands for a depth map."""


def read(gauges: Gauges):
    return gauges.collect_readings(0)


def test_load_is_unknown_without_a_new_measured_record(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 50.0
    monkeypatch.setattr(module, "monotonic", lambda: now_s)
    gauges = Gauges(1e5, stale_s=3.0)
    assert math.isnan(read(gauges).area_mm2)
    gauges.add([make_entry("valid")])
    gauges.update_frame(MEASURED, 600.0)
    now_s = 52.9
    gauges.add([make_entry("missing")])
    assert read(gauges).area_mm2 == 2e4
    assert read(gauges).volume_flow_m3_h == pytest.approx(2e4 * 600 * 3600e-9)
    now_s = 53.1
    assert math.isnan(read(gauges).area_mm2)
    assert math.isnan(read(gauges).volume_flow_m3_h)
    gauges.update_frame(MEASURED, 600.0)
    gauges.add([make_entry("degraded")])
    assert read(gauges).area_mm2 == 2e4


def test_strips_measured_before_do_not_keep_a_load_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow belt leaves the view for long after the core camera has failed."""
    now_s = 50.0
    monkeypatch.setattr(module, "monotonic", lambda: now_s)
    gauges = Gauges(1e5, stale_s=3.0)
    gauges.update_frame(MEASURED, 600.0)
    for _ in range(8):
        now_s += 0.5
        gauges.update_frame(None, 600.0)
        gauges.add([make_entry("valid")])
    assert math.isnan(read(gauges).area_mm2)


def test_values_last_three_usual_intervals_of_the_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 50.0
    monkeypatch.setattr(module, "monotonic", lambda: now_s)
    gauges = Gauges(1e5, stale_s=3.0)
    for _ in range(4):
        now_s += 5.0
        gauges.update_frame(MEASURED, 600.0)
        gauges.add([make_entry("valid")])
    now_s += 14.0
    assert read(gauges).area_mm2 == 2e4
    now_s += 2.0
    assert math.isnan(read(gauges).area_mm2)


def test_findings_reach_the_alarms_and_expire(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 50.0
    monkeypatch.setattr(module, "monotonic", lambda: now_s)
    gauges = Gauges(1e5)
    fault = Finding("zero_shift", 5.0, 0.1, 0.5, "mm", text="the belt has risen", effect="degraded")
    gauges.add_findings([fault, Finding("zero_shift", 0.1, 0.1, 0.5, "mm", "cam2")])
    gauges.add_findings([Finding("zero_shift", NAN, NAN, 0.5, "mm")])  # not made: the fault stays
    assert {one.subject: one.is_fault for one in read(gauges).findings} == {"": True, "cam2": False}
    now_s = 200.0
    assert list(read(gauges).findings) == []


def test_a_repeat_confirms_the_last_measured_frame_and_has_a_speed_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = 50.0
    monkeypatch.setattr(module, "monotonic", lambda: now_s)
    gauges = Gauges(1e5, stale_s=0.5)
    gauges.add([make_entry("valid")])
    gauges.update_frame(MEASURED, 600.0)
    gauges.depth = None  # as an inspection leaves it
    now_s = 50.4
    gauges.update_repeat(0.0)
    assert (gauges.measured_s, gauges.coverage) == (50.4, 0.9)
    assert read(gauges).volume_flow_m3_h == 0.0
    gauges.update_frame(None, 0.0)
    now_s = 50.45
    gauges.update_repeat(0.0)
    assert gauges.measured_s == 50.4  # the last frame that was to be matched gave no depth
