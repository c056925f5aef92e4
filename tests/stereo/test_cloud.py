from __future__ import annotations

import numpy as np
import pytest
from raycast import camera

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.stereo.cloud import cloud_from_depth

CAMERA = camera("cam0", (120, 90))


def measured(z: np.ndarray) -> DepthMap:
    """What a matcher says of a depth (H, W) in mm."""
    there = np.isfinite(z)
    return DepthMap(
        z, np.where(there, np.float32(0.1), np.nan), there.astype(np.uint8), there.astype(np.float32)
    )


def plane(normal: np.ndarray, distance_mm: float) -> DepthMap:
    """Depth of the plane normal·P = distance."""
    rays = np.concatenate([CAMERA.rays(), np.ones((90, 120, 1))], axis=-1)
    z = (distance_mm / (rays @ normal)).astype(np.float32)
    return measured(z)


@pytest.mark.parametrize("tilt", [(0, 0), (0.5, -0.2), (-0.6, 0.5)])
def test_a_plane_has_its_normal_everywhere(tilt):
    normal = np.array([*tilt, 1.0]) / np.linalg.norm([*tilt, 1.0])
    cloud = cloud_from_depth(plane(normal, 600), CAMERA, None)
    np.testing.assert_allclose(cloud.points_mm @ normal, 600, atol=1e-2)
    np.testing.assert_allclose(cloud.normals, np.tile(-normal, (len(cloud.normals), 1)), atol=5e-3)
    assert (np.einsum("ij,ij->i", cloud.normals, cloud.points_mm) < 0).all()


def test_normals_do_not_lean_across_a_step_and_gaps_make_no_points():
    z = np.full((90, 120), 700, np.float32)
    z[:, 60:] = 650
    z[10:20, 10:20] = np.nan
    cloud = cloud_from_depth(measured(z), CAMERA, None)
    assert len(cloud.points_mm) == z.size - 100
    np.testing.assert_allclose(cloud.normals, np.tile([0, 0, -1], (len(cloud.normals), 1)), atol=1e-3)
    np.testing.assert_array_equal(cloud.sigma_mm, np.float32(0.1))


def test_a_pixel_alone_has_no_normal():
    z = np.full((90, 120), np.nan, np.float32)
    z[40, 50] = 700
    cloud = cloud_from_depth(measured(z), CAMERA, None)
    assert cloud.points_mm.shape == (1, 3)
    assert np.isnan(cloud.normals).all()


def test_colour_comes_from_where_the_lens_saw_the_point():
    pixels = np.moveaxis(np.indices((90, 120), np.float32), 0, -1)[..., ::-1]
    image = np.stack([pixels[..., 0], pixels[..., 1], np.full((90, 120), 250)], axis=-1).astype(np.uint8)
    cloud = cloud_from_depth(plane(np.array([0, 0, 1.0]), 600), CAMERA, image)
    seen = CAMERA.project(cloud.points_mm)
    inside = (seen > 2).all(axis=1) & (seen < [117, 87]).all(axis=1)
    np.testing.assert_allclose(cloud.colors[inside, :2], seen[inside] * 255 / 250, atol=1.6)


def test_a_picture_of_another_size_is_refused():
    with pytest.raises(InputError, match="the image is 60×45 px, but cam0 has 120×90"):
        cloud_from_depth(plane(np.array([0, 0, 1.0]), 600), CAMERA, np.zeros((45, 60), np.uint8))
