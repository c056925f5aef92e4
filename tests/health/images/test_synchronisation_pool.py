"""Delays of cameras by many checks: found below the noise of one check, and no camera is accused wrongly."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.health.images.synchronisation import CheckPool, PairCheck, pool_delays
from tests.thorough import THOROUGH, list_cases

DISTANCE_MM, SPEED_MM_S = 700.0, 600.0
RIGS = [
    {"cam1": 0.0, "cam2": -300.0, "cam3": 0.0, "cam4": 300.0},
    {"cam1": 180.0, "cam2": -220.0, "cam3": 90.0},
    {"cam1": 100.0, "cam2": -300.0, "cam3": -50.0, "cam4": 200.0, "cam5": 250.0},
]


def draw_checks(rig, rng, count=12, *, late=None, moved=None, noise_mm=0.1) -> list[PairCheck]:
    """Checks of a rig with errors as sound captures have them; ``late`` and ``moved`` are camera and mm."""
    common, slope = rng.normal(0, 1.5e-4 * DISTANCE_MM), rng.normal(0, 5e-4)
    own = {name: common + slope * b + rng.normal(0, 5e-5 * DISTANCE_MM) for name, b in rig.items()}
    checks = []
    for _ in range(count):
        moving = {name: shift + rng.normal(0, noise_mm) for name, shift in own.items()}
        same = {name: rng.normal(0, 0.03) for name in rig}
        for camera, shift in [one for one in (late, moved) if one is not None]:
            for name in rig if camera == "cam0" else [camera]:
                moving[name] += -shift if camera == "cam0" else shift
                same[name] += (0.2 if late else 1.0) * shift
        checks.append(PairCheck(moving, same, dict.fromkeys(rig, noise_mm), SPEED_MM_S, DISTANCE_MM))
    return checks


def find_late(checks, rig) -> dict[str, float]:
    """Delays, ms, of the accused cameras."""
    found = pool_delays(checks, "cam0", rig)
    return {name: one.delay_ms for name, one in found.items() if one.exceeds(0.1)}


@pytest.mark.parametrize("rig", list_cases(RIGS, RIGS[:1]))
def test_simultaneous_cameras_are_seldom_accused(rig) -> None:
    rng = np.random.default_rng(1)
    accused = [bool(find_late(draw_checks(rig, rng), rig)) for _ in range(1000 if THOROUGH else 400)]

    assert np.mean(accused) <= 0.01


@pytest.mark.parametrize("late_mm", list_cases([0.3, -0.3], [-0.3]))
def test_half_a_millisecond_at_half_a_metre_a_second_is_named(late_mm: float) -> None:
    rng, rig = np.random.default_rng(2), RIGS[0]
    found = [
        find_late(draw_checks(rig, rng, late=("cam3", late_mm)), rig) for _ in range(300 if THOROUGH else 100)
    ]

    assert np.mean([set(one) == {"cam3"} for one in found]) > 0.85
    assert np.mean([bool(set(one) - {"cam3"}) for one in found]) < 0.01
    assert np.mean([one["cam3"] for one in found if one]) == pytest.approx(late_mm / 0.6, rel=0.1)


@pytest.mark.parametrize("rig", list_cases(RIGS, RIGS[1:2]))
@pytest.mark.parametrize("camera", ["cam0", "cam2"])
def test_a_late_camera_is_named_alone_with_its_delay(rig, camera: str) -> None:
    rng = np.random.default_rng(3)
    others = 0
    for _ in range(100):
        found = pool_delays(draw_checks(rig, rng, late=(camera, 3.0)), "cam0", rig)
        accused = {name for name, one in found.items() if one.exceeds(0.1)}
        others += len(accused - {camera})
        assert camera in accused
        assert found[camera].delay_ms == pytest.approx(5.0, abs=4 * found[camera].sigma_ms)
    assert others <= 2


def test_a_camera_that_moved_is_not_called_late() -> None:
    rng, rig = np.random.default_rng(4), RIGS[0]

    assert not any(find_late(draw_checks(rig, rng, moved=("cam1", 1.0)), rig) for _ in range(100))


def test_one_auxiliary_does_not_show_which_of_two_is_late() -> None:
    checks = draw_checks({"cam1": 0.0}, np.random.default_rng(5), late=("cam1", 3.0))

    assert set(pool_delays(checks, "cam0", {"cam1": 0.0})) == {"cam1"}  # against the core, as a single check


def test_few_checks_and_a_covered_camera_give_no_delay() -> None:
    rig = RIGS[0]
    checks = draw_checks(rig, np.random.default_rng(6))
    for check in checks[3:]:
        del check.moving_mm["cam4"]  # type: ignore[attr-defined]

    assert pool_delays(checks[:5], "cam0", rig) == {}
    assert set(pool_delays(checks, "cam0", rig)) == {"cam0", "cam1", "cam2", "cam3"}


def test_the_pool_takes_different_material_and_begins_anew_at_a_change() -> None:
    rng, pool = np.random.default_rng(7), CheckPool()
    sound, late = draw_checks(RIGS[0], rng), draw_checks(RIGS[0], rng, late=("cam2", 3.0))

    assert [len(pool.add(check, 75.0 * n)) for n, check in enumerate(sound[:11])] == [1] * 5 + [2] * 5 + [3]
    assert len(pool.add(late[0], 900.0)) == 1
    assert len(pool.add(late[1], 1000.0)) == 1
    assert len(pool.add(late[2], 1300.0)) == 2
