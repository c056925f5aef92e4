"""Lens models: equal to OpenCV's, derivatives equal to differences, domains that end where the mapping folds."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.geometry import tilt
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.lens_domain import find_valid_radius

LENSES = {
    "brown": [-0.21, 0.09, 0.002, -0.001, 0.03],
    "rational": [0.9, -0.3, 0.001, -0.002, 0.02, 1.1, -0.1, 0.03],
    "thin_prism": [0.9, -0.3, 0.001, -0.002, 0.02, 1.1, -0.1, 0.03, 0.004, -0.001, -0.003, 0.002],
    "tilted": [-0.2, 0.1, 0.001, -0.002, 0.02, 0.1, -0.02, 0.03, 0.004, -0.001, -0.003, 0.002, 0.11, -0.07],
    "fisheye": [-0.03, 0.012, -0.008, 0.002],
}
FISHEYE: Any = cv2.fisheye  # pyrefly: ignore[missing-attribute]
FOCAL, CENTER, SIZE = np.array([610.0, 614.0]), np.array([402.0, 297.0]), (800, 600)


def make_camera(model, coefficients=None, **changes):
    values = LENSES[model] if coefficients is None else coefficients
    return Camera("c", SIZE, FOCAL, CENTER, np.array(values), model, **changes)


def random_points(count=200, radius=0.8, seed=1):
    rng = np.random.default_rng(seed)
    ideal = rng.uniform(-radius, radius, (count, 2)) / np.sqrt(2)
    return np.column_stack([ideal, np.ones(count)]) * rng.uniform(300, 900, (count, 1))


@pytest.mark.parametrize("model", LENSES)
def test_projection_equals_opencv(model):
    camera, points = make_camera(model), random_points()
    project = FISHEYE.projectPoints if model == "fisheye" else cv2.projectPoints
    expected = project(points[:, None], np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)[0]
    np.testing.assert_allclose(camera.project(points), expected.reshape(-1, 2), atol=1e-8)


@pytest.mark.parametrize("model", LENSES)
def test_undistortion_equals_opencv(model):
    camera, points = make_camera(model), random_points()
    pixels = camera.project(points)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    if model == "fisheye":
        found = FISHEYE.undistortPoints(pixels[:, None], camera.matrix, camera.distortion, criteria=criteria)
    else:
        found = cv2.undistortPoints(pixels[:, None], camera.matrix, camera.distortion, criteria=criteria)
    np.testing.assert_allclose(camera.undistort(pixels), found.reshape(-1, 2), atol=1e-7)


@pytest.mark.parametrize("model", LENSES)
def test_undistortion_inverts_projection_up_to_the_domain(model):
    camera = make_camera(model)
    radius = min(camera.valid_radius, 1.2 if model == "brown" else 3.0)
    ideal = random_points(500, 1.0)[:, :2]
    ideal *= (0.999 * radius * np.sqrt(np.linspace(0, 1, 500)) / np.linalg.norm(ideal, axis=1))[:, None]
    pixels = camera.distort(ideal) * camera.focal_px + camera.center_px
    assert np.isfinite(pixels).all()
    np.testing.assert_allclose(camera.undistort(pixels), ideal, atol=1e-8)


@pytest.mark.parametrize("model", LENSES)
def test_derivatives_equal_differences(model):
    lens, coefficients = MODELS[model], np.array(LENSES[model])
    x, y = random_points()[:, :2].T / 900
    h = 1e-6
    xx, xy, yx, yy = lens.differentiate(x, y, coefficients)
    by_x = (np.array(lens.distort(x + h, y, coefficients)) - lens.distort(x - h, y, coefficients)) / (2 * h)
    by_y = (np.array(lens.distort(x, y + h, coefficients)) - lens.distort(x, y - h, coefficients)) / (2 * h)
    np.testing.assert_allclose([xx, yx], by_x, atol=1e-9)
    np.testing.assert_allclose([xy, yy], by_y, atol=1e-9)
    focal_x, focal_y = np.full_like(x, 3.0), np.full_like(x, 5.0)
    found = lens.differentiate_by_coefficients(x, y, coefficients, focal_x, focal_y)
    for i, step in enumerate(np.eye(len(coefficients)) * h):
        ahead, behind = (lens.distort(x, y, coefficients + sign * step) for sign in (1, -1))
        expected = np.array([[3.0], [5.0]]) * (np.array(ahead) - behind) / (2 * h)
        np.testing.assert_allclose(found[i], expected, atol=1e-8, err_msg=lens.coefficients[i])


@pytest.mark.parametrize("model", LENSES)
def test_coefficients_of_each_point_equal_those_of_one_lens(model):
    lens, coefficients = MODELS[model], np.array(LENSES[model])
    x, y = random_points(7)[:, :2].T / 900
    each = np.repeat(coefficients[:, None], 7, axis=1)
    np.testing.assert_array_equal(lens.distort(x, y, coefficients), lens.distort(x, y, each))
    np.testing.assert_array_equal(lens.differentiate(x, y, coefficients), lens.differentiate(x, y, each))


def test_models_contain_each_other():
    x, y = random_points()[:, :2].T / 900
    for inner, outer in (("brown", "rational"), ("rational", "thin_prism"), ("thin_prism", "tilted")):
        values = np.array(LENSES[inner])
        filled = np.concatenate([values, np.zeros(len(MODELS[outer].coefficients) - len(values))])
        np.testing.assert_allclose(
            MODELS[outer].distort(x, y, filled), MODELS[inner].distort(x, y, values), atol=1e-15
        )


def test_the_fisheye_is_smooth_through_its_centre():
    lens, coefficients = MODELS["fisheye"], np.array(LENSES["fisheye"])
    x = np.array([0.0, 1e-9, 1e-5, 0.0999, 0.1001])
    xd, _ = lens.distort(x, np.zeros(5), coefficients)
    t = np.arctan(x) ** 2
    expected = np.arctan(x) * (1 + t * (-0.03 + t * (0.012 + t * (-0.008 + t * 0.002))))
    np.testing.assert_allclose(xd, expected, rtol=1e-14, atol=0)
    assert lens.differentiate(x, 0 * x, coefficients)[0][0] == 1.0


def test_the_tilt_leaves_the_principal_point_and_inverts():
    assert np.abs(tilt.tilt(np.zeros(1), np.zeros(1), 0.2, -0.1)).max() < 1e-15
    x, y = random_points()[:, :2].T / 900
    u, v = tilt.tilt(x, y, 0.2, -0.1)
    np.testing.assert_allclose(tilt.untilt(u, v, 0.2, -0.1), [x, y], atol=1e-14)
    homogeneous = tilt.compute_homography(0.2, -0.1) @ [x, y, np.ones_like(x)]
    np.testing.assert_allclose(homogeneous[:2] / homogeneous[2], [u, v], atol=1e-14)


@given(k1=st.floats(-0.6, -0.05), k2=st.floats(-0.2, 0.02))
def test_the_polynomials_turning_point_is_exact(k1, k2):
    radius = find_valid_radius("brown", np.array([k1, k2, 0, 0, 0]))
    if np.isinf(radius):
        assert 9 * k1 * k1 < 20 * k2
        return
    assert 1 + 3 * k1 * radius**2 + 5 * k2 * radius**4 == pytest.approx(0, abs=1e-7)
    r = np.linspace(0, radius, 500)
    distorted = r * (1 + k1 * r**2 + k2 * r**4)
    assert (np.diff(distorted) > 0).all()


def test_the_domain_ends_at_a_pole_of_the_rational_model():
    coefficients = np.zeros(8)
    coefficients[5] = -0.5  # 1 / (1 - r²/2): a pole at √2
    assert find_valid_radius("rational", coefficients) == pytest.approx(np.sqrt(2))


def test_the_fisheyes_domain_is_in_angles():
    assert find_valid_radius("fisheye", np.zeros(4)) == np.inf
    angle = 1.1
    assert find_valid_radius("fisheye", np.array([-1 / 3 / angle**2, 0, 0, 0])) == pytest.approx(
        np.tan(angle)
    )


@pytest.mark.parametrize("model", ["brown", "thin_prism", "tilted"])
def test_other_terms_shrink_the_domain_to_where_nothing_folds(model):
    lens = MODELS[model]
    coefficients = np.zeros(len(lens.coefficients))
    coefficients[:4] = -0.3, 0, 0.03, -0.02
    radius = find_valid_radius(model, coefficients)
    assert 0.9 < radius < find_valid_radius("brown", np.array([-0.3, 0, 0, 0, 0]))
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    for share, folds in ((0.9999, False), (1.0001, True)):
        x, y = share * radius * np.cos(angle), share * radius * np.sin(angle)
        xx, xy, yx, yy = lens.differentiate(x, y, coefficients)
        assert (xx * yy <= xy * yx).any() == folds


def test_nothing_beyond_the_turning_point_has_a_pixel_or_a_ray():
    camera = make_camera("brown", [-0.35, 0, 0, 0, 0])
    turning = camera.valid_radius
    assert turning == pytest.approx(np.sqrt(1 / 1.05))
    beyond = np.array([[1.3 * turning, 0.0, 1.0], [0.0, -1.3 * turning, 1.0]])
    folded = camera.lens.distort(beyond[:, 0], beyond[:, 1], camera.distortion)[0][0] * FOCAL[0] + CENTER[0]
    assert CENTER[0] < folded < SIZE[0]  # without the domain it would lie in the image
    assert np.isnan(camera.project(beyond)).all()
    edge = turning * (1 - 0.35 * turning**2) * FOCAL[0]
    pixels = np.array([[CENTER[0] + 0.999 * edge, CENTER[1]], [CENTER[0] + 1.001 * edge, CENTER[1]]])
    ideal = camera.undistort(pixels)
    assert np.isfinite(ideal[0]).all()
    assert np.isnan(ideal[1]).all()


@pytest.mark.parametrize("model", LENSES)
def test_a_calibrated_radius_ends_the_domain(model):
    free, camera = make_camera(model), make_camera(model, valid_radius_px=250.0)
    limit = camera.valid_radius
    radial = limit * camera.lens.radial.compute(np.array(limit**2), camera.distortion) * FOCAL.mean()
    assert radial == pytest.approx(250.0)
    points = random_points(radius=1.2)
    inside = np.hypot(*points[:, :2].T) <= limit * points[:, 2]
    assert 0 < inside.sum() < len(points)
    pixels = camera.project(points)
    np.testing.assert_array_equal(np.isfinite(pixels).all(axis=1), inside)
    np.testing.assert_array_equal(pixels[inside], free.project(points)[inside])
    np.testing.assert_array_equal(np.isfinite(camera.undistort(free.project(points))).all(axis=1), inside)


def test_a_camera_refuses_unknown_models_and_wrong_numbers_of_coefficients():
    with pytest.raises(ValueError, match=r"lens model 'pinhole' is unknown; the models are brown, rational"):
        make_camera("pinhole", [0.0] * 5)
    with pytest.raises(ValueError, match=r"fisheye has 4 coefficients \(k1, k2, k3, k4\), 5 were given"):
        make_camera("fisheye", [0.0] * 5)
