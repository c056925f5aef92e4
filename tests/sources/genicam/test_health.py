"""Health of a camera: state, message, rate and counts."""

from __future__ import annotations

from math import isnan

import pytest

from beltscape.sources.genicam.health import SKEWED_FROM, START_IMAGES, CameraMonitor, assess_health
from beltscape.sources.genicam.matching import CameraStatistics
from beltscape.sources.genicam.settings import CamerasSettings

SETTINGS = CamerasSettings(devices={"cam0": "10.0.0.5"}, frames_per_s=10)
LINE = CamerasSettings(devices={"cam0": "10.0.0.5"}, trigger="line")


def health(settings=SETTINGS, monitor=None, statistics=None, trouble="", is_open=True, now_s=100.0):
    seen = CameraMonitor(last_s=99.95) if monitor is None else monitor
    return assess_health(
        "cam0", settings, seen, statistics or CameraStatistics(taken=7), trouble, is_open, now_s
    )


@pytest.mark.parametrize(
    ("given", "state", "message"),
    [
        ({}, "ok", ""),
        ({"monitor": CameraMonitor()}, "waiting", "10.0.0.5 is being started"),
        ({"monitor": CameraMonitor(), "is_open": False}, "waiting", "10.0.0.5 is being searched for"),
        ({"monitor": CameraMonitor(), "is_open": False, "trouble": "no camera"}, "lost", "no camera"),
        (
            {"monitor": CameraMonitor(90.0), "is_open": False, "trouble": "access denied"},
            "waiting",
            "access denied",
        ),
        (
            {"monitor": CameraMonitor(80.0), "is_open": False, "trouble": "access denied"},
            "lost",
            "access denied",
        ),
        ({"monitor": CameraMonitor(90.0, last_s=97.0)}, "waiting", "is being started"),
        ({"monitor": CameraMonitor(90.0, last_s=97.0), "is_open": False}, "waiting", "is being searched for"),
        ({"monitor": CameraMonitor(90.0, last_s=94.0)}, "lost", "no image for 6 s"),
        ({"monitor": CameraMonitor(80.0, last_s=97.0)}, "lost", "no image for 3 s"),
        (
            {"monitor": CameraMonitor(90.0, last_s=97.0), "statistics": CameraStatistics(taken=START_IMAGES)},
            "lost",
            "no image for 3 s",
        ),
        (
            {"monitor": CameraMonitor(90.0, last_s=99.9), "statistics": CameraStatistics(silent=True)},
            "waiting",
            "is being started",
        ),
        ({"monitor": CameraMonitor(), "settings": LINE}, "waiting", "no pulse has come on Line1 yet"),
        ({"now_s": 100.4}, "ok", ""),
        ({"now_s": 101.0}, "lost", "no image for 1 s: check power, cable"),
        ({"now_s": 9000.0, "settings": LINE}, "ok", ""),
        (
            {"statistics": CameraStatistics(silent=True), "settings": LINE},
            "lost",
            "check trigger wire, power",
        ),
        ({"is_open": False, "trouble": "no answer"}, "lost", "(no answer)"),
        ({"monitor": CameraMonitor(last_s=99.9, image_fault="odd")}, "unusable", "odd"),
        ({"monitor": CameraMonitor(last_s=99.9, brightness_fault="dark: x")}, "unusable", "dark: x"),
        ({"statistics": CameraStatistics(unsynchronised=True)}, "unusable", "PTP"),
        ({"statistics": CameraStatistics(out_of_skew=SKEWED_FROM - 1, skew_ns=9_000_000)}, "ok", ""),
        (
            {"statistics": CameraStatistics(out_of_skew=SKEWED_FROM, skew_ns=9_000_000)},
            "unusable",
            "more than allowed_skew_ms = 2 ms: check its trigger wire and trigger delay (+9.00 ms)",
        ),
        (
            {"monitor": CameraMonitor(last_s=99.9, broken=4, broken_s=95)},
            "ok",
            "4 images came with packets missing",
        ),
        ({"monitor": CameraMonitor(last_s=99.9, broken=4, broken_s=80)}, "ok", ""),
    ],
)
def test_health_has_state_and_message(given, state, message):
    camera = health(**given)
    assert camera.state == state
    assert message in camera.message
    assert bool(camera.message) == bool(message)
    assert "\n" not in camera.message


def test_health_has_rate_and_counts():
    monitor = CameraMonitor()
    for i in range(100):
        monitor.add_image(90 + i / 10)
    camera = health(monitor=monitor, statistics=CameraStatistics(taken=100, missed=3, skew_ns=-1_500_000))
    assert (camera.frames, camera.missed, camera.skew_ms) == (100, 3, -1.5)
    assert camera.rate_hz == pytest.approx(10)
    assert isnan(health().skew_ms)
    assert health(monitor=CameraMonitor(last_s=50.0)).rate_hz == 0
