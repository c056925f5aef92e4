"""Adaptive exposure: bounds, steps, hysteresis, and what the cameras are told."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from beltscape.sources.genicam.adaptive_exposure import (
    AdaptiveExposureSettings,
    ExposureChange,
    ExposureController,
    measure_level,
)
from beltscape.sources.genicam.matching import ExposureTimes
from beltscape.sources.genicam.settings import CamerasSettings

BOUNDS = AdaptiveExposureSettings(shortest_us=100, longest_us=3000, every_s=1.0, hold_s=5.0)


def run(
    controller: ExposureController,
    light: float,
    seconds: float,
    begin_s: float = 0.0,
    limit_us: float = np.inf,
) -> list[ExposureChange]:
    """The changes at 10 frames/s under a light in levels per µs."""
    changes: list[ExposureChange] = []
    for number in range(round(10 * seconds)):
        level = min(255.0, light * controller.exposures_us["cam0"])
        change = controller.update(begin_s + 0.1 * number, level, limit_us)
        changes += [] if change is None else [change]
    return changes


@pytest.mark.parametrize("light", [0.06, 0.1, 0.4, 1.2])
def test_the_level_is_reached_in_bounded_steps_and_then_rests(light: float) -> None:
    controller = ExposureController(BOUNDS, {"cam0": 1000.0, "cam1": 1200.0})
    changes = run(controller, light, 60)

    level = light * controller.exposures_us["cam0"]
    assert BOUNDS.level / BOUNDS.tolerance <= level <= BOUNDS.level * BOUNDS.tolerance
    assert all(1 / 1.51 < change.factor < 1.51 for change in changes)
    assert controller.exposures_us["cam1"] == pytest.approx(1.2 * controller.exposures_us["cam0"], rel=0.01)
    assert run(controller, light, 60, 100.0) == []


@pytest.mark.parametrize(("light", "camera", "bound_us"), [(0.002, "cam1", 3000.0), (50.0, "cam0", 100.0)])
def test_no_camera_leaves_the_bounds(light: float, camera: str, bound_us: float) -> None:
    controller = ExposureController(BOUNDS, {"cam0": 1000.0, "cam1": 1200.0})
    run(controller, max(light, 0.02), 120)

    assert all(BOUNDS.shortest_us <= us <= BOUNDS.longest_us for us in controller.exposures_us.values())
    assert controller.exposures_us[camera] == pytest.approx(bound_us, rel=0.02)


def test_an_empty_belt_between_loads_changes_nothing() -> None:
    controller = ExposureController(BOUNDS, {"cam0": 1000.0})
    changes = [controller.update(0.1 * number, 150.0 if number % 40 < 20 else 60.0) for number in range(400)]

    assert changes == [None] * 400


def test_frames_far_apart_are_followed_too() -> None:
    controller = ExposureController(BOUNDS, {"cam0": 1000.0})
    for number in range(40):
        controller.update(4.0 * number, 0.06 * controller.exposures_us["cam0"])

    assert 0.06 * controller.exposures_us["cam0"] > BOUNDS.level / BOUNDS.tolerance


def test_a_covered_lens_and_single_bright_frames_change_nothing() -> None:
    controller = ExposureController(BOUNDS, {"cam0": 1000.0})

    assert run(controller, 0.005, 20) == []
    assert [controller.update(30 + 0.1 * n, 255.0 if n % 9 == 5 else 150.0) for n in range(90)] == [None] * 90


def test_motion_blur_limits_the_exposure_at_once() -> None:
    controller = ExposureController(BOUNDS, {"cam0": 1000.0})
    change = controller.update(0.0, 150.0, 400.0)

    assert change is not None
    assert change.is_by_motion
    assert controller.exposures_us == {"cam0": 400.0}
    assert run(controller, 0.15, 30, 1.0, 400.0) == []  # darker than wanted, but no longer


def test_light_that_changes_slowly_causes_few_changes() -> None:
    controller = ExposureController(BOUNDS, {"cam0": 1000.0})
    changes = [run(controller, light, 10, 10.0 * i) for i, light in enumerate(np.geomspace(0.15, 0.6, 60))]

    assert 3 <= sum(map(len, changes)) <= 8


def test_level_is_that_of_the_bright_pixels_of_the_median_camera() -> None:
    dark, bright = (np.full((64, 64), level, np.uint8) for level in (50, 200))
    deep = np.full((64, 64, 3), 100 * 257, np.uint16)

    assert measure_level({"cam0": dark, "cam1": deep, "cam2": bright}) == pytest.approx(100)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({}, "give exposure_us too"),
        ({"exposure_us": 50}, "outside adaptive_exposure's 100 to 3000"),
        ({"exposure_us": 500, "own": {"cam1": {"exposure_us": 5000}}}, "of cam1 is outside"),
    ],
)
def test_settings_that_do_not_fit_are_refused(more: dict, message: str) -> None:
    given = {
        "devices": {"cam0": "a", "cam1": "b"},
        "adaptive_exposure": {"shortest_us": 100, "longest_us": 3000},
    }

    with pytest.raises(ValidationError, match=message):
        CamerasSettings.model_validate(given | more)
    with pytest.raises(ValidationError, match="must be below"):
        AdaptiveExposureSettings(shortest_us=100, longest_us=100)


def test_images_are_given_the_exposure_time_they_had() -> None:
    triggered = ExposureTimes({"cam0": 1000.0}, 100_000_000, is_triggered=True)
    free = ExposureTimes({"cam0": 1000.0}, 100_000_000, is_triggered=False)
    for times in (triggered, free):
        times.set_present("cam0", 2000.0, 10_000_000_000)

    assert triggered.find("cam0", 10_000_500_000) == 1000.0
    assert triggered.find("cam0", 10_003_000_000) == 2000.0
    assert free.find("cam0", 9_999_000_000) == 1000.0
    assert np.isnan(free.find("cam0", 10_050_000_000))
    assert free.find("cam0", 10_300_000_000) == 2000.0
