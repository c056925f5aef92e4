"""Scaling of cameras to smaller or larger images: the viewing rays stay the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import (
    Rig,
    fit_camera,
    pinhole_scale,
    replace_scaled_cameras,
    scale_camera,
    scale_rig,
)

CAMERA = Camera(
    "cam0",
    (1224, 1024),
    np.array([1163.0, 1162.0]),
    np.array([618.8, 513.5]),
    np.array([-0.07, 0.1, 4e-4, -1e-4, 0.0]),
)


@pytest.mark.parametrize("factor", [0.5, 0.25, 2.0])
def test_ray_meets_the_same_place_of_the_scaled_image(factor):
    scaled = scale_camera(CAMERA, factor)
    ray = np.array([0.1, -0.2])
    one, other = (c.distort(ray) * c.focal_px + c.center_px for c in (CAMERA, scaled))
    np.testing.assert_allclose((one + 0.5) * factor - 0.5, other)


@given(st.integers(1, 2448))
def test_scaled_camera_is_recognised(width):
    factor = width / CAMERA.size_px[0]
    scaled = scale_camera(CAMERA, factor)
    assert scaled.size_px[0] == width
    if width >= 306:
        assert pinhole_scale(CAMERA, scaled) == pytest.approx(factor)


def test_the_undistorted_grid_of_a_camera_is_its_pinhole():
    grid = replace(CAMERA, distortion=np.zeros(5))
    assert pinhole_scale(grid, CAMERA) == 1.0
    assert pinhole_scale(grid, scale_camera(CAMERA, 0.5)) == 0.5


@pytest.mark.parametrize(
    "other",
    [
        replace(CAMERA, focal_px=CAMERA.focal_px * 1.004),
        replace(CAMERA, center_px=CAMERA.center_px + np.array([1.5, 0.0])),
        replace(CAMERA, size_px=(1224, 900)),
    ],
    ids=["focal length", "principal point", "size"],
)
def test_another_pinhole_is_not_taken_for_this_one(other):
    assert pinhole_scale(CAMERA, other) is None


def test_another_camera_is_not_taken_for_a_scaled_one():
    other = Camera("cam0", (612, 512), CAMERA.focal_px * 0.6, CAMERA.center_px / 2, CAMERA.distortion)
    assert pinhole_scale(CAMERA, other) is None


def test_a_rig_keeps_its_poses():
    rig = Rig("cam0", {"cam0": CAMERA}, {"cam0": Pose.identity()})
    half = scale_rig(rig, 0.5)
    assert half.core_camera.size_px == (612, 512)
    assert half.cam_from_core == rig.cam_from_core


@pytest.mark.parametrize("size_px", [(612, 512), (408, 341), (2448, 2048), (918, 768)])
def test_a_camera_fits_binned_and_scaled_images(size_px):
    fitted = fit_camera(CAMERA, size_px)
    assert fitted is not None
    assert fitted.size_px == size_px
    factor = size_px[0] / CAMERA.size_px[0]
    np.testing.assert_allclose(fitted.focal_px / CAMERA.focal_px, factor, rtol=2e-3)
    np.testing.assert_allclose(fitted.center_px, (CAMERA.center_px + 0.5) * factor - 0.5, atol=0.7)


def test_rows_and_columns_that_fill_no_bin_do_not_change_the_focal_length():
    camera = replace(CAMERA, size_px=(1225, 1027))
    fitted = fit_camera(camera, (306, 256))
    assert fitted is not None
    np.testing.assert_array_equal(fitted.focal_px, camera.focal_px / 4)
    np.testing.assert_array_equal(fitted.center_px, (camera.center_px + 0.5) / 4 - 0.5)


@pytest.mark.parametrize("size_px", [(1224, 900), (1000, 1024), (1024, 1224), (1216, 1017), (612, 400)])
def test_a_camera_does_not_fit_cropped_or_turned_images(size_px):
    assert fit_camera(CAMERA, size_px) is None


def test_the_covariance_of_a_scaled_rig_is_in_its_own_pixels():
    covariance = {"parameters": ["cam0.fx_px", "cam0.k1"], "matrix": [[4.0, 2.0], [2.0, 1.0]]}
    quality = {"board": {"kind": "charuco"}, "held_out": {"rms_px": 0.1}}
    rig = Rig("cam0", {"cam0": CAMERA}, {"cam0": Pose.identity()}, quality, covariance)
    half = replace_scaled_cameras(rig, {"cam0": scale_camera(CAMERA, 0.5)})
    assert half.covariance["matrix"] == [[1.0, 1.0], [1.0, 1.0]]
    assert half.quality == {"board": {"kind": "charuco"}}
