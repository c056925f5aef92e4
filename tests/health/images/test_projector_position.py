"""A projector that moved against the cameras: told from its pattern on the bare belt."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding
from beltscape.health.images.projector_position import ProjectorMonitor
from beltscape.health.settings import HealthSettings
from tests.health.images.drawn_belt import RIG, STEP_MM, make_frame
from tests.measure.flow.moving_belt import Heap, depth_map, make_empty_belt

REFERENCE = make_empty_belt()
LEARNING = 3
NARROW = Heap(start_mm=-2000.0, end_mm=2000.0, half_width_mm=130.0)
"""Leaves bare strips at both sides."""


def learn(heap: Heap | None = NARROW, **options) -> ProjectorMonitor:
    """A monitor that has learned the pattern and recognised it once."""
    return deepcopy(learn_once(heap, tuple(options.items())))


@cache
def learn_once(heap: Heap | None, options: tuple[tuple[str, float], ...]) -> ProjectorMonitor:
    monitor = ProjectorMonitor(RIG, REFERENCE, HealthSettings(learning_frames=LEARNING))
    for number in range(LEARNING + 1):
        check(monitor, 8 * number, heap, **dict(options))
    return monitor


def check(
    monitor: ProjectorMonitor, number: int, heap: Heap | None = NARROW, **options
) -> tuple[Finding, ...]:
    depth: DepthMap = options.pop("depth", None) or depth_map(heap, STEP_MM * number)
    return monitor.check(make_frame(number, heap, **options), depth, ())


@pytest.mark.parametrize(("heap", "moved_mm"), [(NARROW, (4.0, 3.0)), (None, (0.0, -30.0))])
def test_a_moved_pattern_is_named_by_the_second_frame(
    heap: Heap | None, moved_mm: tuple[float, float]
) -> None:
    monitor = learn(heap)
    first, second = (check(monitor, number, heap, moved_mm=moved_mm) for number in (40, 41))

    assert np.isnan(first[0].value)
    assert second[0].is_fault
    assert second[0].effect == "none"
    assert second[0].value == pytest.approx(np.hypot(*moved_mm), abs=1.0)


def test_a_projector_turned_about_its_axis_is_named() -> None:
    monitor = learn()
    turned = {"moved_mm": (0.0, 0.0), "turned_deg": 1.0}
    check(monitor, 40, **turned)

    assert check(monitor, 41, **turned)[0].value == pytest.approx(np.deg2rad(1) * 190, abs=1.5)


def test_a_pattern_out_of_reach_is_named() -> None:
    monitor = learn()
    check(monitor, 40, moved_mm=(300.0, 0.0))

    assert "more than" in check(monitor, 41, moved_mm=(300.0, 0.0))[0].text


def test_other_material_on_the_belt_is_no_motion() -> None:
    monitor = learn()
    found = [finding for number in (40, 48, 56) for finding in check(monitor, number)]

    assert len(found) == 3
    assert max(finding.value for finding in found) < 0.3


def test_a_full_belt_a_risen_belt_and_a_moved_camera_are_silent() -> None:
    monitor = learn()
    full = Heap(start_mm=-4000.0, end_mm=4000.0, half_width_mm=420.0, seed=5)
    sound = depth_map(NARROW, STEP_MM * 40)
    risen = replace(sound, depth_mm=sound.depth_mm - np.float32(6))

    for number in (40, 41):
        found = (*check(monitor, number, full), *check(monitor, number, depth=risen, moved_mm=(5.0, 0.0)))
        assert not any(finding.is_fault for finding in found)
    drawn = make_frame(40, NARROW)
    turned = replace(drawn, images={**drawn.images, "cam1": np.roll(drawn.images["cam1"], 2, axis=1)})
    for _ in range(2):
        assert not any(finding.is_fault for finding in monitor.check(turned, sound, ()))


def test_a_moved_core_does_not_accuse_the_projector() -> None:
    moved = Finding("camera_pose", 2.0, 0.1, 0.5, "mm", "cam0", "the core camera cam0 moved", "degraded")
    for others, is_accused in (((moved,), False), ((replace(moved, subject="cam1"),), True)):
        monitor = learn()
        found = [
            monitor.check(
                make_frame(number, NARROW, moved_mm=(5.0, 0.0)), depth_map(NARROW, STEP_MM * number), others
            )
            for number in (40, 41)
        ]
        assert any(finding.is_fault for findings in found for finding in findings) == is_accused


def test_without_a_pattern_nothing_is_found() -> None:
    monitor = learn(speckle=0.0)

    assert not any(finding.is_fault for number in (40, 41) for finding in check(monitor, number, speckle=0.0))


def test_a_faulty_frame_is_not_learned() -> None:
    monitor = ProjectorMonitor(RIG, REFERENCE, HealthSettings(learning_frames=LEARNING))
    fault = Finding("defocus", 1.0, 0.1, 0.5, "%", "cam0", "cam0: blurred")
    for number in range(LEARNING):
        monitor.check(make_frame(8 * number, NARROW), depth_map(NARROW, STEP_MM * 8 * number), (fault,))

    assert check(monitor, 40) == ()
