"""Delays of cameras on a moving belt, told from what they show of the moving material."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.findings import Finding
from beltscape.health.images import synchronisation_monitor
from beltscape.health.images.synchronisation import CameraDelay, compute_depth_error, separate_delay
from beltscape.health.images.synchronisation_monitor import SynchronisationMonitor
from beltscape.health.settings import HealthSettings
from beltscape.workers.calls import CallMaker, CallsOfPool, make_call
from beltscape.workers.processes import open_process_pool
from tests.health.images.drawn_belt import ALONG, RIG, STEP_MM, make_frame
from tests.measure.flow.moving_belt import Heap, depth_map
from tests.thorough import list_cases, list_rows

HEAP = Heap(start_mm=-2000.0, end_mm=2000.0, half_width_mm=260.0)


def run(
    frames: int = 4,
    *,
    speed_mm_s: float = 1000.0,
    step: int = 1,
    calls: CallMaker | None = None,
    **options,
) -> list[tuple[Finding, ...]]:
    """The findings of a monitor over frames of a loaded belt."""
    monitor = SynchronisationMonitor(RIG, HealthSettings(), calls=calls)
    out: list[tuple[Finding, ...]] = []
    for number in range(0, step * frames, step):
        drawn = make_frame(number, HEAP, speed_mm_s=speed_mm_s, **options)
        out.append(monitor.check(drawn, depth_map(HEAP, STEP_MM * number), STEP_MM * number, ALONG))
    return out


@pytest.mark.parametrize("late_mm", list_cases([2.0, -5.0], [2.0]))
def test_auxiliaries_are_not_accused_while_the_core_has_moved(late_mm: float) -> None:
    moved = Finding("camera_pose", 2.0, 0.1, 0.5, "mm", "cam0", "the core camera cam0 moved", "degraded")
    for others, accused in (((moved,), set[str]()), ((replace(moved, subject="cam1"),), {"cam2"})):
        monitor = SynchronisationMonitor(RIG, HealthSettings())
        found = [
            monitor.check(
                make_frame(number, HEAP, speed_mm_s=1000.0, late_mm={"cam2": late_mm}),
                depth_map(HEAP, STEP_MM * number), STEP_MM * number, ALONG, others,
            )
            for number in range(3)
        ]  # fmt: skip
        assert set(find_faults(found[-1])) == accused


def test_workers_compare_the_frames_with_the_same_findings(monkeypatch: pytest.MonkeyPatch) -> None:
    here = run(3, late_mm={"cam2": -5.0})
    monkeypatch.setattr(
        synchronisation_monitor, "measure_displacement", lambda *_: pytest.fail("compared here")
    )
    with open_process_pool(make_call, None, 1) as pool:
        there = run(3, late_mm={"cam2": -5.0}, calls=CallsOfPool(pool))
    assert find_faults(there[-1])
    assert [repr(one) for one in there] == [repr(one) for one in here]


def find_faults(findings: tuple[Finding, ...]) -> dict[str, Finding]:
    return {finding.subject: finding for finding in findings if finding.is_fault}


@pytest.mark.parametrize(("speed_mm_s", "speckle"), list_rows([(500.0, 0.5), (5000.0, 0.8)], [(500.0, 0.5)]))
def test_simultaneous_cameras_pass(speed_mm_s: float, speckle: float) -> None:
    checked = run(2, speed_mm_s=speed_mm_s, speckle=speckle)[-1]

    assert {finding.subject for finding in checked if abs(finding.value) < 2 * finding.sigma} == {
        "cam0",
        "cam1",
        "cam2",
    }
    assert not find_faults(checked)


@pytest.mark.parametrize(
    ("camera", "late_mm", "speed_mm_s"),
    list_rows(
        [("cam1", 2.0, 2000.0), ("cam2", -5.0, 1000.0), ("cam2", 5.0, 5000.0)], [("cam2", -5.0, 1000.0)]
    ),
)
def test_a_late_camera_is_named_by_the_second_check(camera: str, late_mm: float, speed_mm_s: float) -> None:
    findings = run(3, speed_mm_s=speed_mm_s, late_mm={camera: late_mm})

    assert not find_faults(findings[1])  # one check accuses no camera, nor does it pass
    assert np.isnan(next(finding for finding in findings[1] if finding.subject == camera).value)
    fault = find_faults(findings[2])
    assert set(fault) == {camera}
    assert fault[camera].value == pytest.approx(1000 * late_mm / speed_mm_s, abs=4 * fault[camera].sigma)
    assert fault[camera].effect == "degraded"


def test_a_late_core_is_named_not_all_the_others() -> None:
    fault = find_faults(run(3, late_mm={"cam0": 3.0})[2])

    assert set(fault) == {"cam0"}
    assert fault["cam0"].value == pytest.approx(3.0, abs=4 * fault["cam0"].sigma)


def test_an_image_of_the_frame_before_is_named() -> None:
    monitor = SynchronisationMonitor(RIG, HealthSettings())
    for number in (5, 6):
        drawn = make_frame(number, HEAP, images_of={"cam1": number - 1})
        findings = monitor.check(drawn, depth_map(HEAP, STEP_MM * number), STEP_MM * number, ALONG)

    fault = find_faults(findings)["cam1"]
    assert fault.value == pytest.approx(-STEP_MM)
    assert (
        "cam1: its images are taken 70 ms before the other cameras' (70 mm of the belt's travel)"
        in fault.text
    )


def test_a_standing_belt_and_slow_steps_show_no_delay() -> None:
    monitor = SynchronisationMonitor(RIG, HealthSettings())
    drawn, depth = make_frame(0, HEAP, late_mm={"cam1": 5.0}), depth_map(HEAP, 0.0)

    assert [monitor.check(drawn, depth, 0.01 * number, ALONG) for number in range(4)] == [()] * 4


@pytest.mark.parametrize("turns", list_cases([(1, 1, 1), (1, 0, -1), (0, 1, 0)], [(1, 1, 1), (1, 0, -1)]))
def test_a_moved_or_vibrating_camera_is_not_called_late(turns: tuple[int, ...]) -> None:
    monitor, moved = SynchronisationMonitor(RIG, HealthSettings()), 0
    for number in range(3):
        drawn = make_frame(number, HEAP)
        images = dict(drawn.images)
        images["cam1"] = np.roll(
            images["cam1"], turns[number], axis=0
        )  # 1: turned by 0.3°, 3.7 mm on the belt
        frames = type(drawn)(drawn.frame, images, drawn.time_ns)
        findings = monitor.check(frames, depth_map(HEAP, STEP_MM * number), STEP_MM * number, ALONG)
        moved += sum(np.isnan(finding.value) for finding in findings if finding.subject == "cam1")
        assert not find_faults(findings)
    assert moved or turns != (1, 1, 1)


def test_a_delay_holds_until_a_check_disproves_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beltscape.health.images.synchronisation_monitor._EVERY", 1)
    monkeypatch.setattr("beltscape.health.images.synchronisation_monitor._PERIOD_NS", 0)
    monitor = SynchronisationMonitor(RIG, HealthSettings())
    named: list[bool] = []
    for number in range(8):
        drawn = make_frame(number, HEAP, late_mm={"cam1": 5.0 if number < 3 else 0.0})
        depth = None if number == 3 else depth_map(HEAP, STEP_MM * number)
        named.append(bool(find_faults(monitor.check(drawn, depth, STEP_MM * number, ALONG))))

    assert named == [False, False, True, True, True, True, True, False]


def test_at_a_high_frame_rate_a_second_passes_between_two_checks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beltscape.health.images.synchronisation_monitor._EVERY", 1)
    slow, fast = (run(6, speed_mm_s=frames_per_s * STEP_MM) for frames_per_s in (1.0, 30.0))
    assert [bool(findings) for findings in slow] == [False, True, False, True, False, True]
    assert [bool(findings) for findings in fast] == [False, True, False, False, False, False]


def delays(speeds_mm_s, delay_ms: float, shift_mm: float) -> list[CameraDelay]:
    return [CameraDelay(1e-3 * delay_ms * speed + shift_mm, 0.1, speed) for speed in speeds_mm_s]


def test_speeds_distinguish_a_moved_camera_from_a_delay() -> None:
    delay_ms, sigma_ms = separate_delay(delays((500.0, 1000.0, 2000.0), 0.8, 2.0))

    assert delay_ms == pytest.approx(0.8)
    assert sigma_ms < 0.1
    assert separate_delay(delays((1000.0, 1000.0), 0.8, 0.0))[1] == np.inf


def test_depth_error_follows_the_baseline_along_the_travel() -> None:
    along = ALONG
    across, lengthwise = (compute_depth_error(name, 3.0, along, 700.0, RIG) for name in ("cam1", "cam2"))

    assert across == 0
    assert lengthwise == pytest.approx(3.0 * 700 / 120 / 2)
    assert compute_depth_error("cam0", 3.0, along, 700.0, RIG) == pytest.approx(lengthwise, rel=0.01)
