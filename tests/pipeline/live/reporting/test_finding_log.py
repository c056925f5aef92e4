"""Findings are stored about once a second, and at once when a fault begins or ends."""

from __future__ import annotations

from dataclasses import replace
from math import nan

import pytest

from beltscape.core.errors import OutputError
from beltscape.core.findings import Finding
from beltscape.pipeline.live.event_log import FindingLog
from beltscape.pipeline.live.gauges import Gauges
from beltscape.sinks.historian import StoredFinding

SOUND = Finding("zero_shift", 0.0, 0.1, 2.0, "mm")
FAULT = replace(SOUND, value=3.0, text="the belt has risen", effect="degraded")


class Kept:
    """A historian that keeps findings, or refuses them."""

    def __init__(self) -> None:
        self.findings: list[StoredFinding] = []
        self.is_full = False

    def add_findings(self, findings: list[StoredFinding]) -> None:
        if self.is_full:
            raise OutputError("full")
        self.findings += findings


@pytest.fixture
def now() -> list[float]:
    return [0.0]


def make_log(now: list[float]) -> tuple[FindingLog, Kept]:
    return FindingLog(lambda: now[0], lambda: int(now[0] * 1e9)), Kept()


def test_a_changing_value_is_stored_once_a_second(now: list[float]) -> None:
    log, kept = make_log(now)
    for k in range(160):  # 20 s at 8 frames a second
        now[0] = k / 8
        log.put([replace(SOUND, value=float(k)), replace(SOUND, check="lamp", subject="a", value=float(k))])
    log.store(kept)  # type: ignore[arg-type]
    assert [one.finding.value for one in kept.findings if one.finding.check == "lamp"] == [
        8.0 * s for s in range(20)
    ]
    assert len(kept.findings) == 40


def test_a_steady_value_is_stored_every_ten_seconds(now: list[float]) -> None:
    log, kept = make_log(now)
    for k in range(8 * 31):
        now[0] = k / 8
        log.put([replace(SOUND, value=0.02 * (k % 2))])
    log.store(kept)  # type: ignore[arg-type]
    assert [one.wall_ns for one in kept.findings] == [0, 10_000_000_000, 20_000_000_000, 30_000_000_000]


def test_begin_and_end_of_a_fault_are_stored_at_once(now: list[float]) -> None:
    log, kept = make_log(now)
    for k, finding in enumerate((SOUND, FAULT, FAULT, SOUND, replace(SOUND, value=nan))):
        now[0] = k / 8
        log.put([finding])
    log.store(kept)  # type: ignore[arg-type]
    assert [one.finding.is_fault for one in kept.findings] == [False, True, False]


def test_findings_that_the_disk_refuses_are_offered_again_in_order(now: list[float]) -> None:
    log, kept = make_log(now)
    kept.is_full = True
    for k in range(3):
        now[0] = 2.0 * k
        log.put([replace(SOUND, value=float(k))])
        log.store(kept)  # type: ignore[arg-type]
    kept.is_full = False
    log.store(kept)  # type: ignore[arg-type]
    log.store(kept)  # type: ignore[arg-type]
    assert [one.finding.value for one in kept.findings] == [0.0, 1.0, 2.0]


def test_a_fault_of_a_single_frame_reaches_the_alarms() -> None:
    gauges = Gauges(1e5)
    gauges.add_findings([SOUND])
    gauges.add_findings([FAULT])
    gauges.add_findings([SOUND])

    def collect() -> list[Finding]:
        return list(gauges.collect_readings(0).findings)

    assert collect() == [FAULT]
    assert collect() == [SOUND]
