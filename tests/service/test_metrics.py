"""Metrics in Prometheus's format, and access to them."""

from __future__ import annotations

import re
from dataclasses import replace
from math import nan

import pytest

from beltscape.core.alarms import Alarm
from beltscape.core.events import CameraHealth
from beltscape.core.findings import Finding
from beltscape.service.api.metrics import MEDIA_TYPE, format_metrics
from tests.service.feeder import CAPACITY
from tests.service.plants import OPEN, make_service

SAMPLE = re.compile(r"([a-z_:][a-z0-9_:]*)(?:\{(.*)\})? (\S+)")
LABEL = re.compile(r'([a-z_]+)="((?:[^"\\]|\\.)*)"(?:,|$)')


def parse_metrics(text: str) -> tuple[dict[str, str], dict[str, dict[tuple, float]]]:
    """Return types and samples; check the text format's order of HELP, TYPE and samples, each family once."""
    types: dict[str, str] = {}
    samples: dict[str, dict[tuple, float]] = {}
    family = ""
    assert text.endswith("\n")
    for line in text.splitlines():
        if line.startswith("# HELP "):
            family = line.split()[2]
            assert family not in types and len(line.split(maxsplit=3)[3]) > 10
        elif line.startswith("# TYPE "):
            assert line.split()[2] == family
            types[family] = line.split()[3]
        else:
            match = SAMPLE.fullmatch(line)
            assert match, line
            name, labels, value = match.groups()
            suffixes = ("_bucket", "_sum", "_count") if types[family] == "histogram" else ("",)
            assert name in {family + suffix for suffix in suffixes}
            pairs = LABEL.findall(labels or "")
            assert "".join(f'{key}="{text}",' for key, text in pairs).rstrip(",") == (labels or "")
            key = tuple(pairs)
            assert key not in samples.setdefault(name, {})
            samples[name][key] = float(value)
    return types, samples


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    made = make_service(tmp_path_factory.mktemp("metrics"), 12, access=OPEN)
    yield made
    made.history.close()


def test_metrics_have_values_and_types(made):
    made.plant.raise_alarm(Alarm("disk_full", "critical", "raised", nan, nan, "", 1))
    made.plant.raise_alarm(Alarm("camera_lost:cam2", "warning", "gone", nan, nan, "", 1))
    types, samples = parse_metrics(made.browser()("GET", "/metrics").text)
    now = made.live_state.take_snapshot()
    assert samples["beltscape_flow_cubic_metres_per_hour"][()] == pytest.approx(now.flow.volume_m3_h)
    assert samples["beltscape_volume_cubic_metres_total"][()] == pytest.approx(now.totals.volume_mm3 * 1e-9)
    metres = {labels[0][1]: value for labels, value in samples["beltscape_belt_metres_total"].items()}
    assert metres == {"valid": pytest.approx(12 * 0.48), "degraded": 0.0, "missing": 0.0}
    assert samples["beltscape_frame_sets_total"][()] == 12
    assert samples["beltscape_frame_sets_repeated_total"][()] == 0
    assert samples["beltscape_capacity_frame_sets_per_second"][()] == CAPACITY.sets_per_s
    assert samples["beltscape_capacity_belt_speed_metres_per_second"][()] == CAPACITY.speed_mm_s * 1e-3
    assert samples["beltscape_camera_state"][(("camera", "cam1"), ("state", "ok"))] == 1
    assert samples["beltscape_camera_state"][(("camera", "cam1"), ("state", "lost"))] == 0
    assert samples["beltscape_camera_skew_seconds"][(("camera", "cam3"),)] == pytest.approx(4e-5)
    assert samples["beltscape_disk_trouble"][()] == 1
    gone = (("alarm", "camera_lost:cam2"), ("severity", "warning"))
    assert samples["beltscape_alarm_active"][gone] == 0
    assert samples["beltscape_alarm_unacknowledged"][gone] == 1
    for name, kind in types.items():
        assert (kind == "counter") == name.endswith("_total"), name


def test_the_histogram_is_cumulative(made):
    _, samples = parse_metrics(format_metrics(made.live_state, made.live_state.take_snapshot()))
    buckets = list(samples["beltscape_processing_seconds_bucket"].values())
    assert buckets == sorted(buckets)
    assert buckets[-1] == samples["beltscape_processing_seconds_count"][()] == 12
    assert 0.1 < samples["beltscape_processing_seconds_sum"][()] / 12 < 0.2


def test_unknown_values_are_left_out_and_names_are_escaped(made):
    now = replace(made.live_state.take_snapshot(), cameras=(CameraHealth('a"b\\c\n', "ok", 1, 0, nan, nan),))
    now = replace(now, frames=replace(now.frames, speed_mm_s=nan))
    types, samples = parse_metrics(format_metrics(made.live_state, now))
    assert types["beltscape_belt_speed_metres_per_second"] == "gauge"
    assert "beltscape_belt_speed_metres_per_second" not in samples
    assert "beltscape_camera_skew_seconds" not in samples
    assert (("camera", r"a\"b\\c\n"),) in samples["beltscape_camera_images_total"]


def test_open_metrics_are_limited_to_this_machine(tmp_path):
    made = make_service(tmp_path, metrics_open=True)
    here = made.browser()
    answer = here("GET", "/metrics")
    assert answer.status_code == 200 and answer.headers["content-type"] == MEDIA_TYPE
    here.address = "10.1.2.3"
    assert here("GET", "/metrics").status_code == 401
    here.address = "127.0.0.1"
    assert here("GET", "/api/state").status_code == 401
    made.history.close()


def test_a_key_reads_the_metrics(tmp_path):
    made = make_service(tmp_path)
    there = made.browser()
    there.address = "10.1.2.3"
    assert there("GET", "/metrics").status_code == 401
    key = made.access.keys.create("prometheus")
    answer = there("GET", "/metrics", {"authorization": f"Bearer {key}"})
    assert answer.status_code == 200
    assert answer.headers["content-type"] == MEDIA_TYPE
    made.history.close()


def test_checks_are_metrics_with_value_sigma_limit_and_fault(tmp_path):
    made = make_service(tmp_path, 3, access=OPEN)
    made.plant.send_findings(
        [
            Finding("dirt", 6.2, 0.5, 2.0, "%", "cam2", "cam2: dirt", "degraded"),
            Finding("zero_shift", 0.3, 0.1, 2.0, "mm"),
            Finding("lamp", nan, nan, nan, "%"),
        ]
    )
    made.plant.begin_maintenance("cleaning", 5, "ana")
    _, samples = parse_metrics(made.browser()("GET", "/metrics").text)
    dirt, zero = (("check", "dirt"), ("subject", "cam2")), (("check", "zero_shift"), ("subject", ""))
    assert samples["beltscape_check_value"] == {(*dirt, ("unit", "%")): 6.2, (*zero, ("unit", "mm")): 0.3}
    assert samples["beltscape_check_sigma"] == {dirt: 0.5, zero: 0.1}
    assert samples["beltscape_check_limit"] == {dirt: 2.0, zero: 2.0}
    assert samples["beltscape_check_fault"] == {dirt: 1, zero: 0, (("check", "lamp"), ("subject", "")): 0}
    assert samples["beltscape_maintenance"] == {(): 1}
    assert "beltscape_flow_cubic_metres_per_hour" not in samples
    made.history.close()
