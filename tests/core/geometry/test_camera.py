"""The camera model: projection and undistortion, compared with OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.geometry.camera import Camera
from tests.strategies import cameras, poses, seeds


def pixels_in(camera: Camera, seed: int, count: int = 50) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, np.array(camera.size_px) - 1, (count, 2))


def points_before(camera: Camera, seed: int) -> np.ndarray:
    """(50, 3) points that the undistorted image holds, 300 to 3000 mm away."""
    ideal = (pixels_in(camera, seed) - camera.center_px) / camera.focal_px
    depth = np.random.default_rng(seed + 1).uniform(300, 3000, (len(ideal), 1))
    return np.concatenate([ideal * depth, depth], axis=1)


@given(cameras(), seeds)
def test_project_agrees_with_opencv(camera, seed):
    points = points_before(camera, seed)
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    np.testing.assert_allclose(camera.project(points), expected.reshape(-1, 2), atol=1e-8)


@given(cameras(), seeds)
def test_undistort_agrees_with_opencv(camera, seed):
    pixels = pixels_in(camera, seed)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    expected = cv2.undistortPoints(
        pixels.reshape(-1, 1, 2), camera.matrix, camera.distortion, criteria=criteria
    )
    np.testing.assert_allclose(camera.undistort(pixels), expected.reshape(-1, 2), atol=1e-9)


@given(cameras(), seeds)
def test_undistort_undoes_distort(camera, seed):
    pixels = pixels_in(camera, seed)
    again = camera.distort(camera.undistort(pixels)) * camera.focal_px + camera.center_px
    np.testing.assert_allclose(again, pixels, atol=1e-9)


@pytest.mark.parametrize(
    ("focal_px", "distortion"),
    [(535, [-0.29, 0.11, 0.0013, -3e-5, 0]), (500, [0.2, 0.1, 0, 0, 0]), (500, [-0.2, 0, 0, 0, 0.02])],
    ids=["OpenCV's sample camera", "pincushion", "barrel"],
)
def test_strong_lenses_are_undistorted_to_the_last_digits(focal_px, distortion):
    camera = Camera("c", (640, 480), np.full(2, focal_px), np.array([320.0, 240.0]), np.array(distortion))
    corners = np.array([[0.0, 0.0], [639, 0], [0, 479], [639, 479], [320, 240]])
    again = camera.distort(camera.undistort(corners)) * camera.focal_px + camera.center_px
    np.testing.assert_allclose(again, corners, atol=1e-9)


def test_pixel_that_the_lens_cannot_produce_is_nan():
    camera = Camera(
        "c", (640, 480), np.full(2, 400.0), np.array([320.0, 240.0]), np.array([-0.3, 0, 0, 0, 0])
    )
    ideal = camera.undistort(
        np.array([[0.0, 0.0], [320.0, 240.0]])
    )  # 1 - 0.3 r² turns back at a radius of 0.70
    assert np.isnan(ideal[0]).all()
    np.testing.assert_array_equal(ideal[1], [0, 0])


@given(cameras(), st.floats(-1000, 0))
def test_point_behind_the_camera_has_no_pixel(camera, depth):
    assert np.isnan(camera.project(np.array([[10.0, 20.0, depth]]))).all()


@given(cameras())
def test_the_axis_meets_the_principal_point(camera):
    np.testing.assert_array_equal(camera.project(np.array([0.0, 0.0, 500.0])), camera.center_px)


@given(cameras(), poses())
def test_project_keeps_the_shape_of_a_batch(camera, pose):
    points = np.arange(2 * 5 * 3, dtype=float).reshape(2, 5, 3) + 1
    assert camera.project(pose.apply(points)).shape == (2, 5, 2)


def test_rays_belong_to_pixel_centres():
    camera = Camera("c", (4, 3), np.array([100.0, 50.0]), np.array([1.0, 2.0]), np.zeros(5))
    rays = camera.rays()
    assert rays.shape == (3, 4, 2)
    np.testing.assert_array_equal(rays[2, 1], [0.0, 0.0])  # the principal point lies on pixel (u=1, v=2)
    np.testing.assert_allclose(rays[0, 3], [0.02, -0.04])


def test_cameras_cannot_be_changed():
    camera = Camera("c", (4, 3), np.ones(2), np.ones(2), np.zeros(5))
    with pytest.raises(AttributeError):
        camera.name = "other"  # pyrefly: ignore[read-only]
