"""The simulated time-of-flight camera: noise and systematic errors."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.time_of_flight import (
    TofTruth,
    compute_subpixel_rays,
    compute_wiggling_mm,
    integrate_irradiance,
    make_tof_camera,
    simulate_tof_frame,
)
from beltscape.simulate.time_of_flight_signal import (
    TofSettings,
    combine_phases,
    common_range_mm,
    unambiguous_range_mm,
)
from tests.thorough import examples

IDEAL = partial(
    TofSettings,
    size_px=(64, 48),
    harmonics=(0.0, 0.0),
    intensity_error_mm=0.0,
    scatter=0.0,
    multipath=False,
    read_noise_e=0.0,
    ambient_e=0.0,
    full_well_e=np.inf,
)
QUIET = partial(IDEAL, amplitude_e=1e14)
"""Without noise, as far as float32 tells."""
SPREAD = 2e-5
"""The mean distance over a pixel as coarse as these is not quite that of its middle."""


def flat(camera: TofSettings, depth_mm: float, albedo: float = 0.5, samples: int = 1) -> TofTruth:
    shape = compute_subpixel_rays(camera, samples).shape[:2]
    return TofTruth(np.full(shape, depth_mm), np.full(shape, albedo), np.ones(shape))


def test_camera_has_the_angles_of_view_of_the_paper():
    camera = make_tof_camera(TofSettings())
    corner = camera.undistort(np.array([-0.5, -0.5]))
    assert camera.size_px == (640, 480)
    np.testing.assert_allclose(np.rad2deg(2 * np.arctan(-corner)), [43, 33])


@examples(15)
@given(st.floats(300, 5000), st.floats(0.05, 0.9))
def test_depth_without_errors_is_exact(depth, albedo):
    camera = QUIET()
    frame = simulate_tof_frame(flat(camera, depth, albedo, samples=2), camera, 0)
    np.testing.assert_allclose(frame.depth_mm, depth, rtol=SPREAD)


@pytest.mark.parametrize("frequencies", [(25e6,), (50e6, 60e6)])
@pytest.mark.parametrize(("depth", "albedo"), [(800.0, 0.05), (800.0, 0.6), (2500.0, 0.3)])
def test_noise_on_a_plane_equals_the_predicted_sigma(frequencies, depth, albedo):
    camera = IDEAL(
        size_px=(160, 120), ambient_e=5000, read_noise_e=30, modulation_hz=frequencies, min_amplitude_e=0
    )
    frame = simulate_tof_frame(flat(camera, depth, albedo), camera, 7)
    error = (frame.depth_mm - depth) / frame.sigma_mm
    assert np.std(error) == pytest.approx(1, abs=0.03)
    assert abs(np.mean(error)) < 0.04


def test_sigma_follows_the_formula_and_grows_with_distance_and_darkness():
    camera = IDEAL(size_px=(8, 8), angle_deg=(1.01, 1.01), min_amplitude_e=0)

    def sigma(depth, albedo):
        return float(simulate_tof_frame(flat(camera, depth, albedo), camera, 0).sigma_mm[4, 4])

    electrons = 100_000 * 0.5
    by_hand = unambiguous_range_mm(25e6) / (2 * np.pi) * np.sqrt(electrons / 2) / (0.5 * electrons)
    assert sigma(1000, 0.5) == pytest.approx(by_hand, rel=1e-3)
    assert sigma(2000, 0.5) == pytest.approx(2 * sigma(1000, 0.5), rel=1e-3)  # shot noise only
    assert sigma(1000, 0.05) == pytest.approx(np.sqrt(10) * sigma(1000, 0.5), rel=1e-3)


def test_wiggling_has_four_periods_per_range():
    camera = QUIET(size_px=(8, 8), angle_deg=(1.01, 1.01), harmonics=(0.02, 0.005))
    depths = np.linspace(200, 5700, 56)
    middle = np.linalg.norm(np.append(compute_subpixel_rays(camera, 1)[4, 4], 1.0))
    found = np.array([simulate_tof_frame(flat(camera, d), camera, 0).depth_mm[4, 4] - d for d in depths])
    expected = compute_wiggling_mm(depths * middle, camera, 25e6) / middle
    np.testing.assert_allclose(found, expected, atol=0.01)
    quarter = unambiguous_range_mm(25e6) / 4
    np.testing.assert_allclose(
        compute_wiggling_mm(depths + quarter, camera, 25e6),
        compute_wiggling_mm(depths, camera, 25e6),
        atol=1e-9,
    )
    assert np.abs(found).max() == pytest.approx(
        (0.02 - 0.005) * unambiguous_range_mm(25e6) / (2 * np.pi), rel=0.05
    )


def test_intensity_error_follows_its_curve():
    camera = QUIET(intensity_error_mm=8.0, intensity_half_e=1e13)
    for albedo in (0.05, 0.4, 0.9):
        frame = simulate_tof_frame(flat(camera, 1000, albedo), camera, 0)
        along = 1 / np.linalg.norm(np.append(compute_subpixel_rays(camera, 1)[24, 32], 1.0))
        expected = 8.0 * 1e13 / (1e13 + float(frame.amplitude_e[24, 32])) * along
        assert frame.depth_mm[24, 32] - 1000 == pytest.approx(expected, abs=0.01)


@examples(20)
@given(st.integers(1, 3), st.floats(500, 1500), st.floats(10, 800))
def test_flying_pixels_lie_between_the_surfaces(columns, near, gap):
    """A step through the middle of a column of pixels, ``columns`` of four sub-pixels on the near side."""
    camera = QUIET()
    truth = flat(camera, near + gap, samples=4)
    edge = 4 * 30 + columns
    truth.depth_mm[:, :edge] = near
    depth = simulate_tof_frame(truth, camera, 0).depth_mm
    assert ((depth[:, 30] > near * (1 + SPREAD)) & (depth[:, 30] < (near + gap) * (1 - SPREAD))).all()
    np.testing.assert_allclose(depth[:, :30], near, rtol=SPREAD)
    np.testing.assert_allclose(depth[:, 31:], near + gap, rtol=SPREAD)


def test_flying_pixel_lies_nearer_to_the_brighter_surface():
    camera = QUIET()
    middle = []
    for albedo in (0.1, 0.5, 0.9):
        truth = flat(camera, 1300.0, samples=2)
        truth.depth_mm[:, :61] = 1000.0
        truth.albedo[:, :61] = albedo
        middle.append(float(simulate_tof_frame(truth, camera, 0).depth_mm[24, 30]))
    assert middle[0] > middle[1] > middle[2]


def wall(camera: TofSettings, sign: int, albedo: float) -> TofTruth:
    """Two planes at right angles; their common line runs down the middle, 1000 mm away. +1: a corner, -1: a ridge."""
    x = compute_subpixel_rays(camera, 1)[..., 0]
    depth = 1000 / (1 + sign * np.abs(x))  # z = 1000 − sign |X|
    return TofTruth(depth, np.full(depth.shape, albedo))


def test_concave_corner_is_measured_too_far_and_a_ridge_correctly():
    camera = QUIET(multipath=True, patch_px=4, receiver_px=2)
    corner, ridge, dark = wall(camera, 1, 0.7), wall(camera, -1, 0.7), wall(camera, 1, 0.05)
    bias = simulate_tof_frame(corner, camera, 0).depth_mm - corner.depth_mm
    assert (bias[4:-4, 4:-4] > 0).all()
    middle = float(bias[20:28, 26:38].mean())
    assert 2 < middle < 60
    assert np.abs(simulate_tof_frame(ridge, camera, 0).depth_mm - ridge.depth_mm).max() < 0.05
    assert (
        float((simulate_tof_frame(dark, camera, 0).depth_mm - dark.depth_mm)[20:28, 26:38].mean())
        < middle / 8
    )


def test_one_bounce_agrees_with_a_sum_over_every_pixel():
    camera = QUIET(multipath=True, patch_px=4, receiver_px=2)
    fine = camera.model_copy(update={"patch_px": 2, "receiver_px": 1})
    corner = wall(camera, 1, 0.7)
    coarse_bias, fine_bias = (
        simulate_tof_frame(corner, c, 0).depth_mm - corner.depth_mm for c in (camera, fine)
    )
    inner = (slice(8, -8), slice(8, -8))
    away = np.abs(np.arange(48) - 23.5) > 6  # nearer to the line a disc is a coarse stand-in
    assert np.abs(coarse_bias[inner] - fine_bias[inner])[:, away].max() < 0.25 * fine_bias[inner].max()


def test_form_factor_of_a_perpendicular_wall_is_exact():
    """Form factor of a wall of height h, very long, at a distance a: (1 − a / √(a² + h²)) / 2."""
    height, a, cell = 600.0, 100.0, 10.0
    y, z = np.meshgrid(np.arange(-6000, 6000, cell) + cell / 2, np.arange(0, height, cell) + cell / 2)
    wall_at = np.column_stack([np.zeros(y.size), y.ravel(), z.ravel()])
    facing = np.tile([1.0, 0.0, 0.0], (y.size, 1))
    sources = (wall_at, facing, np.full(y.size, cell**2), np.ones(y.size))
    found = integrate_irradiance(np.array([[a, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]), sources, 1e-3)
    assert abs(found[0]) == pytest.approx((1 - a / np.hypot(a, height)) / 2, rel=0.01)


def test_scattered_light_biases_dark_pixels_towards_bright_ones():
    camera = QUIET(scatter=0.01)
    truth = flat(camera, 1500.0, 0.05)
    truth.depth_mm[:, :20], truth.albedo[:, :20] = 800.0, 0.9
    frame = simulate_tof_frame(truth, camera, 0)
    assert (frame.depth_mm[:, 30:] < 1500 - 5).all()
    assert np.abs(frame.depth_mm[:, :20] - 800).max() < 2


def test_one_frequency_wraps_beyond_its_range_and_two_do_not():
    one, two = QUIET(), QUIET(modulation_hz=(50e6, 60e6))
    assert common_range_mm(one.modulation_hz) == pytest.approx(5995.85, abs=0.01)
    assert common_range_mm(two.modulation_hz) == pytest.approx(14_989.6, abs=0.1)
    truth = flat(one, 8000.0)
    along = np.linalg.norm(np.append(compute_subpixel_rays(one, 1)[24, 32], 1.0))
    np.testing.assert_allclose(simulate_tof_frame(truth, two, 0).depth_mm, 8000, atol=0.02)
    assert simulate_tof_frame(truth, one, 0).depth_mm[24, 32] == pytest.approx(
        8000 - unambiguous_range_mm(25e6) / along, abs=0.02
    )


@given(st.floats(50, 14_900), st.sampled_from([(50e6, 60e6), (50e6, 60e6, 110e6), (30e6, 40e6)]))
def test_every_distance_in_the_common_range_is_recovered(distance, frequencies):
    distance = np.full((1, 1), distance * common_range_mm(frequencies) / 15_000)
    phases = np.array([4 * np.pi * f * distance / 299_792_458_000 for f in frequencies])
    phases = np.angle(np.exp(1j * phases))
    found, sigma = combine_phases(phases, np.full(phases.shape, 3.0), frequencies)
    np.testing.assert_allclose(found, distance, atol=1e-6)
    np.testing.assert_allclose(sigma, 3 / np.sqrt(len(frequencies)))


def test_dark_saturated_and_empty_pixels_are_nan():
    camera = IDEAL(min_amplitude_e=1000, full_well_e=300_000)
    truth = flat(camera, 1000.0)
    truth.albedo[:, :10] = 0.001
    truth.depth_mm[:, 10:20] = np.nan
    truth.depth_mm[:, 20:30] = 200.0
    frame = simulate_tof_frame(truth, camera, 0)
    assert np.isnan(frame.depth_mm[:, :30]).all()
    assert np.isnan(frame.sigma_mm[:, :30]).all()
    assert np.isfinite(frame.depth_mm[:, 30:]).all()
    assert (frame.amplitude_e[:, 10:20] == 0).all()


def test_all_errors_together_stay_finite_and_repeat_by_seed():
    camera = TofSettings(size_px=(64, 48))
    truth = wall(camera, 1, 0.3)
    truth.depth_mm[:5] = np.nan
    first, again, other = (simulate_tof_frame(truth, camera, seed) for seed in (3, 3, 4))
    assert first.depth_mm.dtype == np.float32
    assert first.depth_mm.tobytes() == again.depth_mm.tobytes()
    assert first.depth_mm.tobytes() != other.depth_mm.tobytes()
    assert np.isfinite(first.depth_mm[8:]).all()


def test_cosines_are_estimated_from_depth_where_none_are_given():
    camera = QUIET()
    rays = compute_subpixel_rays(camera, 1)
    depth = 1000 / (1 + 0.5 * rays[..., 0])
    normal = np.array([0.5, 0.0, 1.0]) / np.hypot(0.5, 1)
    along = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    cosine = along @ normal / np.linalg.norm(along, axis=-1)
    albedo = np.full(depth.shape, 0.4)
    expected, found = (
        simulate_tof_frame(TofTruth(depth, albedo, c), camera, 0).amplitude_e for c in (cosine, None)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_arrays_of_other_shapes_are_refused():
    camera = QUIET()
    with pytest.raises(InputError, match="truth of 65×48 is no multiple of 64×48"):
        simulate_tof_frame(TofTruth(np.ones((48, 65)), np.ones((48, 65))), camera, 0)
    with pytest.raises(InputError, match="albedo is"):
        simulate_tof_frame(TofTruth(np.ones((48, 64)), np.ones((48, 63))), camera, 0)


@pytest.mark.parametrize("wrong", [{"modulation_hz": ()}, {"contrast": 0}, {"scatter": 1}, {"lens": 3}])
def test_settings_have_bounds(wrong):
    with pytest.raises(ValidationError):
        TofSettings(**wrong)


def test_frame_of_a_world_uses_cast_rays():
    from beltscape.simulate.time_of_flight import render_tof
    from beltscape.simulate.world import Label, Solid, World

    square = np.array([[-900.0, -900, 0], [900, -900, 0], [900, 900, 0], [-900, 900, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    block = square / 9 + [0, 0, 100]
    solids = (
        Solid("belt", Label.BELT, square, faces, (0.05, 0.05, 0.05)),
        Solid("block", Label.MATERIAL, block, faces, (0.6, 0.6, 0.6)),
    )
    pose = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 800.0]))
    frame = render_tof(World(solids, None), pose, QUIET(), samples=2)
    assert frame.depth_mm[24, 32] == pytest.approx(700, abs=0.02)
    assert frame.depth_mm[2, 2] == pytest.approx(800, abs=0.02)
