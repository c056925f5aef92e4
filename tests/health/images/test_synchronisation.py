"""Delay of a camera from the residuals of its tie points on a moving belt."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.health.images.synchronisation import (
    check_synchronisation,
    estimate_motion_offset,
    predict_image_motion,
    separate_delay,
)
from beltscape.health.settings import HealthSettings
from tests.health.images.speckled_belt import make_rig

RIG = make_rig()
GENERATOR = np.random.default_rng(4)
POINTS = np.column_stack([GENERATOR.uniform(-200, 200, (300, 2)), GENERATOR.uniform(600, 720, 300)])


def measure(delay_ms: float, speed_mm_s: float, shift_px: float = 0.0, noise_px: float = 0.2):
    motion = predict_image_motion(POINTS, np.array([0.0, speed_mm_s, 0.0]), RIG, "cam1")
    noise = noise_px * np.random.default_rng(round(speed_mm_s)).standard_normal(motion.shape)
    residual = delay_ms * motion + noise + np.array([0.0, shift_px])
    return estimate_motion_offset(residual, motion, speed_mm_s)


@pytest.mark.parametrize("delay_ms", [0.1, -0.5, 5.0])
def test_delay_is_estimated_within_its_sigma(delay_ms: float) -> None:
    offset = measure(delay_ms, 2000.0)

    assert abs(offset.delay_ms - delay_ms) < 4 * offset.sigma_ms
    assert offset.sigma_ms < 0.03


def test_outliers_do_not_matter() -> None:
    motion = predict_image_motion(POINTS, np.array([0.0, 2000.0, 0.0]), RIG, "cam1")
    residual = 1.0 * motion
    residual[::10] += 30
    residual[5] = np.nan

    assert estimate_motion_offset(residual, motion, 2000.0).delay_ms == pytest.approx(1.0, abs=0.2)


def test_standing_belt_gives_no_delay() -> None:
    assert measure(1.0, 0.0).sigma_ms == np.inf


def test_speeds_distinguish_a_moved_camera_from_a_delay() -> None:
    delay, sigma = separate_delay([measure(0.8, speed, shift_px=2.0) for speed in (500.0, 1000.0, 2000.0)])

    assert delay == pytest.approx(0.8, abs=4 * sigma)
    assert sigma < 0.1


def test_one_speed_cannot_tell_them() -> None:
    assert separate_delay([measure(0.8, 1000.0)] * 3)[1] == np.inf


def test_finding_needs_limit_and_sigma() -> None:
    settings = HealthSettings()

    assert not check_synchronisation("cam1", 0.5, 0.01, settings).is_fault
    assert not check_synchronisation("cam1", 1.5, 0.6, settings).is_fault
    late = check_synchronisation("cam1", 1.5, 0.1, settings)
    assert late.effect == "degraded"
    assert "1.5 ms after" in late.text
