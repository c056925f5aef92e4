"""Readings of a plant that is in order, what raises each alarm, and a board that they are given to."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from beltscape.alarms.board import AlarmBoard
from beltscape.alarms.readings import Readings
from beltscape.alarms.settings import AlarmSettings, OversizeLump
from beltscape.core.events import CameraHealth, CameraState, CertificateReading

NAN = float("nan")
SECOND = 1_000_000_000
SETTINGS = AlarmSettings(oversize_lump=OversizeLump(size_mm=200))


def camera(name="cam2", state: CameraState = "ok", skew_ms=0.1, message=""):
    return CameraHealth(name, state, 10, 0, 25.0, skew_ms, message)


GOOD = Readings(
    area_mm2=5e4,
    area_sigma_mm2=1e3,
    full_area_mm2=1e5,
    volume_flow_m3_h=300,
    volume_flow_sigma_m3_h=3,
    mass_flow_t_h=500,
    mass_flow_sigma_t_h=5,
    belt_mm=0,
    speed_mm_s=1500,
    coverage=0.9,
    largest_lump_mm=90,
    largest_lump_sigma_mm=9,
    belt_offset_mm=3,
    belt_offset_sigma_mm=2,
    cameras={"cam2": camera(), "cam3": camera("cam3")},
    dropped_per_minute=0,
    history_trouble="",
    history_repair="",
    users_trouble="",
    reports_trouble="",
    recording_trouble="",
    gpu_trouble="",
    encoder_silent_s=0.01,
    encoder_trouble="",
    certificate_days=200,
    test_certificate=CertificateReading("2026-0001", 300.0),
)
BAD: dict[str, dict[str, Any]] = {
    "overload": {"area_mm2": 1.2e5},
    "empty": {"area_mm2": 500.0},
    "belt_stopped": {"speed_mm_s": 0.0},
    "oversize_lump": {"largest_lump_mm": 230.0},
    "misaligned_belt": {"belt_offset_mm": -70.0},
    "low_coverage": {"coverage": 0.4},
    "cameras_off": {"cameras": {name: camera(name, state="lost") for name in ("cam2", "cam3")}},
    "camera_lost:cam2": {
        "cameras": {"cam2": camera(state="lost", message="silent for 1.0 s; check its cable"), "cam3": camera("cam3")}
    },
    "camera_skew": {"cameras": {"cam2": camera(skew_ms=-5.0), "cam3": camera("cam3")}},
    "frames_dropped": {"dropped_per_minute": 30.0},
    "disk_full": {"history_trouble": "no space left; free some"},
    "history_repaired": {"history_repair": "it was deleted; written again"},
    "users_unreadable": {"users_trouble": "file is not a database; restore it"},
    "reports_failing": {"reports_trouble": "there is no printer 'office'"},
    "recording_paused": {"recording_trouble": "no space left; free some"},
    "gpu_lost": {"gpu_trouble": "CUDA_ERROR_DEVICE_LOST"},
    "encoder_silent": {"encoder_silent_s": 9.0},
    "encoder_wrong": {"encoder_trouble": "runs backwards"},
    "no_measurement:load": {"area_mm2": NAN, "volume_flow_m3_h": NAN, "mass_flow_t_h": NAN},
    "no_measurement:speed": {"speed_mm_s": NAN},
    "no_measurement:lump": {"largest_lump_mm": NAN},
    "no_measurement:offset": {"belt_offset_mm": NAN},
    "certificate_expiring": {"certificate_days": 12.0},
    "material_test_due": {"test_certificate": CertificateReading("2026-0001", 5.0)},
    "test_certificate_void": {"test_certificate": CertificateReading("2026-0001", 300.0, ("rig",))},
}  # fmt: skip


class Plant:
    """A board, and the clocks that go with it."""

    def __init__(self, settings=SETTINGS):
        self.board = AlarmBoard(settings)
        self.second = 0

    def run(self, readings, seconds, every_s=1):
        """Update once a second; return every alarm whose shown state changed."""
        return [alarm for alarm, before in self.run_all(readings, seconds, every_s) if alarm.state != before]

    def run_all(self, readings, seconds, every_s=1):
        """Update once a second; return every alarm that changed, also while hidden, and the state shown before."""
        changed = []
        for _ in range(0, seconds, every_s):
            self.second += every_s
            now = replace(readings, belt_mm=1500.0 * self.second)
            shown = self.states()
            for alarm in self.board.update(now, 10**18 + self.second * SECOND, self.second * SECOND):
                changed.append((alarm, shown.get(alarm.name, "clear")))
        return changed

    def states(self):
        return {alarm.name: alarm.state for alarm in self.board.alarms}
