"""An ageing lamp is named; changes of material, hall light, exposure, focus and air are not accused."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from tests.health.images.speckled_belt import NAMES, blur, make_frame, make_rig
from tests.thorough import THOROUGH, list_cases

LEARNING = 5


@cache
def learn() -> ImageMonitor:
    one = ImageMonitor(make_rig(), HealthSettings(learning_frames=LEARNING))
    for number in range(LEARNING + 1):
        one.check_images(make_frame(number))
    return one


def make_monitor() -> ImageMonitor:
    """Return a monitor that has learned its reference values."""
    return deepcopy(learn())


def find_lamp(monitor: ImageMonitor, frames: FrameSet) -> Finding:
    return next(one for one in monitor.check_images(frames).findings if one.check == "lamp")


@pytest.mark.parametrize(
    ("share", "count"),
    [
        (0.5, 10),
        pytest.param(0.7, 30, marks=pytest.mark.thorough),
        pytest.param(0.5, 30, marks=pytest.mark.thorough),
        pytest.param(0.6, 10, marks=pytest.mark.thorough),
        pytest.param(0.6, 30, marks=pytest.mark.thorough),
        pytest.param(0.7, 10, marks=pytest.mark.thorough),
    ],
)
def test_an_ageing_lamp_is_named_with_its_own_light(share: float, count: int) -> None:
    monitor = make_monitor()
    lamps = [1 - (1 - share) * (k + 1) / count for k in range(count)]
    found = [find_lamp(monitor, make_frame(LEARNING + 1 + k, lamp=lamp)) for k, lamp in enumerate(lamps)]
    for lamp, one in zip(lamps, found, strict=True):
        assert abs(one.value - 100 * lamp) < 2.5 * one.sigma < 5
        assert one.is_fault == (one.value + 2 * one.sigma < 80)
    assert found[-1].is_fault
    assert found[-1].effect == "none"


@pytest.mark.parametrize("lamp", list_cases([1.1, 0.9, 0.83], [1.1, 0.83]))
def test_a_little_less_or_more_light_is_no_fault(lamp: float) -> None:
    monitor = make_monitor()
    for number in range(LEARNING + 1, LEARNING + 4):
        assert not find_lamp(monitor, make_frame(number, lamp=lamp)).is_fault


ORDINARY: dict[str, dict[str, float]] = {
    "hall light off": {"hall": 0.0},
    "hall light doubled": {"hall": 2.0},
    "dark coal": {"stones": 0.2},
    "limestone": {"stones": 1.8},
    "empty belt": {"stones": 0.6},
}


@pytest.mark.parametrize("change", ORDINARY)
def test_ordinary_changes_are_not_accused(change: str) -> None:
    monitor = make_monitor()
    for number in range(LEARNING + 1, LEARNING + (12 if THOROUGH else 5)):
        lamp = find_lamp(monitor, make_frame(number, **ORDINARY[change]))  # type: ignore[arg-type]
        assert not lamp.is_fault
        assert np.isnan(lamp.value) or abs(lamp.value - 100) < 2.5 * lamp.sigma < 5


def scatter(light: np.ndarray) -> np.ndarray:
    return 0.4 * light + 0.6 * blur(light, 60)


@pytest.mark.parametrize("change", [lambda light: blur(light, 2.0), scatter], ids=["out of focus", "dust"])
def test_a_pattern_without_contrast_is_not_an_old_lamp(change: Callable[[np.ndarray], np.ndarray]) -> None:
    monitor = make_monitor()
    for number in range(LEARNING + 1, LEARNING + 4):
        assert not find_lamp(monitor, make_frame(number, lambda _, light: change(light))).is_fault


@pytest.mark.parametrize("longer", [0.5, 1.6])
def test_another_exposure_time_is_no_other_light(longer: float) -> None:
    monitor = ImageMonitor(make_rig(), HealthSettings(learning_frames=LEARNING))

    def examine(number: int, factor: float) -> Finding:
        frames = make_frame(number, lambda _, light: factor * light)
        return find_lamp(monitor, replace(frames, exposures_us=dict.fromkeys(NAMES, 1000 * factor)))

    for number in range(LEARNING + 1):
        examine(number, 1.0)
    lamp = examine(LEARNING + 1, longer)
    assert lamp.value == pytest.approx(100, abs=2.0)
    assert not lamp.is_fault


def test_material_over_the_whole_view_is_not_measured() -> None:
    monitor = make_monitor()
    rng = np.random.default_rng(3)
    for number in range(LEARNING + 1, LEARNING + (12 if THOROUGH else 5)):
        stones = np.kron(rng.uniform(0.3, 0.9, (20, 25)), np.ones((16, 16))).astype(np.float32)
        lamp = find_lamp(monitor, make_frame(number, lambda _, light, stones=stones: stones * light))
        assert not lamp.is_fault


def test_without_a_projector_all_light_counts() -> None:
    monitor = ImageMonitor(make_rig(), HealthSettings(learning_frames=LEARNING, projector="no"))
    faults = []
    for number in range(LEARNING + 15):
        share = 1 - 0.04 * max(number - LEARNING, 0)
        frames = make_frame(number, lambda _, light, share=share: share * light, speckle=False)
        faults.append(find_lamp(monitor, frames).is_fault)
    assert not any(faults[: LEARNING + 9])
    assert faults[-1]
