"""Point clouds: points, normals and colours of a depth map."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.stereo.pointcloud import CloudBuilder, cloud_from_depth, undistort_image
from tests.stereo.raycast import make_camera

CAMERA = make_camera("cam0", (120, 90))


def make_depth_map(z: np.ndarray) -> DepthMap:
    """Return the depth map of a depth (H, W) in mm."""
    measured = np.isfinite(z)
    return DepthMap(
        z, np.where(measured, np.float32(0.1), np.nan), measured.astype(np.uint8), measured.astype(np.float32)
    )


def make_plane(normal: np.ndarray, distance_mm: float) -> DepthMap:
    """Return the depth map of the plane normal·P = distance."""
    rays = np.concatenate([CAMERA.rays(), np.ones((90, 120, 1))], axis=-1)
    z = (distance_mm / (rays @ normal)).astype(np.float32)
    return make_depth_map(z)


@pytest.mark.parametrize("tilt", [(0, 0), (0.5, -0.2), (-0.6, 0.5)])
def test_a_plane_has_its_normal_everywhere(tilt):
    normal = np.array([*tilt, 1.0]) / np.linalg.norm([*tilt, 1.0])
    cloud = cloud_from_depth(make_plane(normal, 600), CAMERA, None)
    np.testing.assert_allclose(cloud.points_mm @ normal, 600, atol=1e-2)
    np.testing.assert_allclose(cloud.normals, np.tile(-normal, (len(cloud.normals), 1)), atol=5e-3)
    assert (np.einsum("ij,ij->i", cloud.normals, cloud.points_mm) < 0).all()


def test_normals_ignore_steps_and_gaps_have_no_points():
    z = np.full((90, 120), 700, np.float32)
    z[:, 60:] = 650
    z[10:20, 10:20] = np.nan
    cloud = cloud_from_depth(make_depth_map(z), CAMERA, None)
    assert len(cloud.points_mm) == z.size - 100
    np.testing.assert_allclose(cloud.normals, np.tile([0, 0, -1], (len(cloud.normals), 1)), atol=1e-3)
    np.testing.assert_array_equal(cloud.sigma_mm, np.float32(0.1))


def test_isolated_pixel_has_no_normal():
    z = np.full((90, 120), np.nan, np.float32)
    z[40, 50] = 700
    cloud = cloud_from_depth(make_depth_map(z), CAMERA, None)
    assert cloud.points_mm.shape == (1, 3)
    assert np.isnan(cloud.normals).all()


def test_colour_is_that_of_the_distorted_pixel():
    pixels = np.moveaxis(np.indices((90, 120), np.float32), 0, -1)[..., ::-1]
    image = np.stack([pixels[..., 0], pixels[..., 1], np.full((90, 120), 250)], axis=-1).astype(np.uint8)
    cloud = cloud_from_depth(make_plane(np.array([0, 0, 1.0]), 600), CAMERA, image)
    seen = CAMERA.project(cloud.points_mm)
    inside = (seen > 2).all(axis=1) & (seen < [117, 87]).all(axis=1)
    np.testing.assert_allclose(cloud.colors[inside, :2], seen[inside] * 255 / 250, atol=1.6)


def test_image_of_another_size_is_refused():
    with pytest.raises(InputError, match="the image is 60×45 px, but cam0 has 120×90"):
        cloud_from_depth(make_plane(np.array([0, 0, 1.0]), 600), CAMERA, np.zeros((45, 60), np.uint8))


def test_builder_can_be_used_for_many_frames():
    builder = CloudBuilder(CAMERA)
    for seed in (1, 2):
        depth, image = make_rough_surface(CAMERA, seed)
        kept, fresh = builder.build(depth, image), cloud_from_depth(depth, CAMERA, image)
        for name in ("points_mm", "normals", "colors", "sigma_mm"):
            np.testing.assert_array_equal(getattr(kept, name), getattr(fresh, name))


def test_a_depth_map_of_another_size_is_refused():
    with pytest.raises(InputError, match="the depth map is 60×45 px, but cam0 has 120×90"):
        CloudBuilder(CAMERA).build(make_depth_map(np.full((45, 60), 700, np.float32)), None)


# images wider and higher than a strip
@pytest.mark.parametrize("size_px", [(5, 7), (300, 500), (1300, 130)])
@pytest.mark.parametrize("kind", ["grey", "deep", "colour"])
def test_cloud_computed_in_strips_equals_the_definition(size_px, kind):
    own = make_camera("cam0", size_px)
    depth, grey = make_rough_surface(own, 3)
    image = {
        "grey": grey,
        "deep": grey.astype(np.uint16) * 40,
        "colour": np.stack([grey, grey // 2, grey], -1),
    }
    cloud = cloud_from_depth(depth, own, image[kind])
    measured = depth.measured
    np.testing.assert_allclose(cloud.points_mm, depth.points_mm(own)[measured], rtol=3e-7)
    np.testing.assert_allclose(cloud.normals, compute_normals(depth.depth_mm, own)[measured], atol=3e-5)
    undistorted = undistort_image(image[kind], own)
    shown = np.clip(undistorted * (255 / np.percentile(undistorted, 99.5)), 0, 255).astype(int)
    shown = shown if shown.ndim == 3 else shown[..., None].repeat(3, axis=2)
    assert (
        np.abs(cloud.colors - shown[measured]).max() <= 1
    )  # a product of float32 may fall below the next integer
    np.testing.assert_array_equal(cloud.sigma_mm, depth.sigma_mm[measured])


def make_rough_surface(own: Camera, seed: int) -> tuple[DepthMap, np.ndarray]:
    """Return a wavy surface with a step and gaps, and a random grey image."""
    rng = np.random.default_rng(seed)
    width, height = own.size_px
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    z = 700 + 20 * np.sin(u / 40) + 10 * np.cos(v / 30) + rng.normal(0, 0.05, (height, width))
    z[height // 3 :, width // 2 :] -= 60
    z[rng.random(z.shape) < 0.2] = np.nan
    return make_depth_map(z.astype(np.float32)), rng.integers(0, 200, z.shape, dtype=np.uint8)


def compute_normals(depth_mm: np.ndarray, own: Camera) -> np.ndarray:
    """Return (H, W, 3) float64 normals from windows of 5 px, mirrored at the border, over inverse depth."""
    inverse = (1 / depth_mm).astype(np.float64)
    du, dv = compute_mean_step(inverse), compute_mean_step(inverse.T).T
    x, y = np.moveaxis(own.rays(), -1, 0)
    a, b = du * own.focal_px[0], dv * own.focal_px[1]
    normal = -np.stack([a, b, inverse - a * x - b * y], axis=-1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def compute_mean_step(values: np.ndarray) -> np.ndarray:
    """Return the mean step to the next column over 4 steps of 5 rows, of steps below 1 %; NaN without any."""
    step = np.full(values.shape, np.nan)
    step[:, :-1] = np.diff(values, axis=1)
    step[~(np.abs(step) < 0.01 * values)] = np.nan
    windows = sliding_window_view(np.pad(step, ((2, 2), (2, 1)), mode="reflect"), (5, 4))
    count = np.isfinite(windows).sum(axis=(-2, -1))
    return np.divide(
        np.nansum(windows, axis=(-2, -1)), count, out=np.full(values.shape, np.nan), where=count > 0
    )
