"""Occlusion, motion and light of a planned rig."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.plan.baseline import visible_shares
from beltscape.plan.light import (
    blur_mm,
    compute_light_budget,
    compute_motion,
    count_cores,
    defocus_px,
    electrons_per_lux_s,
    frames_per_second,
    matching_sigma_px,
    max_exposure_us,
    needed_contrast_e,
)
from beltscape.plan.settings import (
    CameraSettings,
    LightSettings,
    PlannedBelt,
    PlanSettings,
    PrecisionSettings,
)
from tests.thorough import examples

directions = st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=4).map(np.array)


@examples(15)
@given(directions, st.floats(0, 0.7))
def test_more_lumps_occlude_more(others, cover):
    straight_up = np.zeros(2)
    seen = visible_shares(straight_up, others, cover)
    assert seen[0] == pytest.approx(1)
    assert all(a >= b - 1e-12 for a, b in pairwise(seen))
    more = visible_shares(straight_up, others, cover + 0.2)
    assert all(b <= a + 1e-9 for a, b in zip(seen, more, strict=True))


def test_direction_of_the_core_sees_everything_the_core_sees():
    assert visible_shares(np.array([0.2, 0.1]), np.array([[0.2, 0.1]]), 0.5) == pytest.approx((1, 1))
    assert visible_shares(np.zeros(2), np.array([[0.4, 0.0], [0.0, 0.4]]), 0.0) == pytest.approx((1, 1, 1))


def test_visible_shares_agree_with_simulated_balls():
    """Monte Carlo: balls thrown about a spot; of throws in which the core sees it, how many others do."""
    core, others, cover = np.array([0.1, 0.0]), np.array([[0.5, 0.0], [-0.4, 0.1], [0.0, 0.45]]), 0.35
    rng = np.random.default_rng(5)
    reach, density = 4.0, -np.log(1 - cover) / np.pi
    rays = np.array([[*t, 1.0] for t in [core, *others]])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    counts = np.zeros(4)
    for _ in range(12_000):
        number = rng.poisson(density * (2 * reach) ** 2)
        balls = np.column_stack([rng.uniform(-reach, reach, (number, 2)), np.ones(number)])
        clear = ((np.cross(balls[:, None], rays) ** 2).sum(axis=-1) >= 1).all(axis=0)
        if clear[0]:
            counts[: clear[1:].sum() + 1] += 1
    np.testing.assert_allclose(visible_shares(core, others, cover), counts / counts[0], atol=0.015)


def test_blur_and_frame_rate_match_manual_calculation():
    assert blur_mm(2.0, 100.0) == pytest.approx(0.2)
    assert max_exposure_us(2.0, 0.5, 0.4) == pytest.approx(100.0)
    assert frames_per_second(2.0, 500.0, 1) == pytest.approx(4.0)
    assert frames_per_second(2.0, 500.0, 3) == pytest.approx(12.0)
    move = compute_motion(PlanSettings(), 0.4, 500.0)
    assert (move.exposure_us, move.blur_px) == pytest.approx((100.0, 0.5))
    assert move.data_mb_s == pytest.approx(5 * 2448 * 2048 * 12 / 1e6)
    assert move.cores == pytest.approx(6.0)  # half a second of a core for a set of 612 × 512 px
    assert count_cores(12.0, 5, (306, 256)) == pytest.approx(1.5)
    assert frames_per_second(move.max_speed_m_s, 500.0, 3) == pytest.approx(79.1)


@given(st.floats(0.01, 10), st.floats(10, 2000), st.integers(1, 20))
def test_frame_rate_shows_every_point_in_the_requested_frames(speed, length, count):
    interval_mm = speed * 1000 / frames_per_second(speed, length, count)
    assert interval_mm * count == pytest.approx(length)


def test_belt_that_stands_still_may_be_exposed_for_a_frames_time():
    plan = PlanSettings(belt=PlannedBelt(speed_m_s=0))
    move = compute_motion(plan, 0.4, 500.0)
    assert move.exposure_us == pytest.approx(1e6 / 79.1)
    assert (move.fps, move.blur_mm) == (0, 0)


def test_electrons_match_manual_calculation():
    """1 lx on a white diffuser at f/2 without loss: 1/16 lx behind the lens (far away)."""
    plan = PlanSettings(
        camera=CameraSettings(f_number=2.0, transmission=1.0, quantum_efficiency=1.0, pitch_um=10.0),
        light=LightSettings(reflectance=1.0, lumens_per_watt=500.0, wavelength_nm=500.0),
    )
    photons = (1 / 16) / 500 / (6.62607015e-34 * 299_792_458 / 500e-9) * (10e-6) ** 2
    assert electrons_per_lux_s(plan, 1e9) == pytest.approx(photons, rel=1e-6)


@given(st.floats(10, 20_000), st.floats(0, 2000), st.floats(0.02, 0.9), st.floats(5, 200))
def test_needed_exposure_and_lumens_give_the_requested_snr(lumens, ambient, reflectance, snr):
    light = LightSettings(projector_lm=lumens, ambient_lux=ambient, reflectance=reflectance, target_snr=snr)
    plan = PlanSettings(light=light)
    first = compute_light_budget(plan, 800.0, 5e5, 100.0)
    assert compute_light_budget(plan, 800.0, 5e5, first.needed_exposure_us).snr == pytest.approx(
        snr, rel=1e-6
    )
    brighter = light.model_copy(update={"projector_lm": first.needed_lumens})
    again = compute_light_budget(plan.model_copy(update={"light": brighter}), 800.0, 5e5, 100.0)
    assert again.snr == pytest.approx(snr, rel=1e-6)
    contrast = needed_contrast_e(snr, first.gap_e, 2.5)
    assert contrast / np.sqrt(contrast + first.gap_e + 2.5**2) == pytest.approx(snr)


def test_matching_noise_grows_in_poor_light_only():
    plan = PlanSettings()
    assert matching_sigma_px(plan, 200.0) == pytest.approx(0.03)
    assert matching_sigma_px(plan, 1.275) == pytest.approx(np.hypot(0.03, 0.012 * np.sqrt(100**2 - 1)))
    assert matching_sigma_px(plan, 0.0) == np.inf
    wide = PlanSettings(precision=PrecisionSettings(patch_px=42))
    assert matching_sigma_px(wide, 5.0) == pytest.approx(matching_sigma_px(plan, 5.0) / 2)


def test_defocus_is_zero_at_the_focus_and_equal_at_both_ends():
    plan = PlanSettings()
    near, far = 700.0, 900.0
    focus = 2 * near * far / (near + far)
    assert defocus_px(plan, focus, focus) == 0
    assert defocus_px(plan, focus, near) == pytest.approx(defocus_px(plan, focus, far))
