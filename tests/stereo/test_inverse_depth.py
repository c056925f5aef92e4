"""Packed projections compared with the rig's projection, and the unit of inverse depth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.kernels import load
from beltscape.kernels.reference.view import project
from beltscape.stereo.multiview.surface import compute_inverse_depth_scale, pack_projection
from tests.strategies import looking_rigs, seeds

steps = st.sampled_from([1, 2, 4])

LENS = np.array([-0.1, 0.05, 1e-3, -5e-4, 0.01])


@given(looking_rigs(), seeds, steps, steps)
def test_packed_projection_equals_that_of_the_rig(rig, seed, core_step, aux_step):
    rng = np.random.default_rng(seed)
    unit = compute_inverse_depth_scale(rig, rig.auxiliaries)
    core, name = rig.core_camera, rng.choice(rig.auxiliaries)
    u, v = rng.uniform(0, 1, (2, 50)) * (np.array(core.size_px)[:, None] - 1)
    z = rng.uniform(600, 2000, 50)
    ideal = (np.stack([u, v], axis=1) - core.center_px) / core.focal_px
    points = np.column_stack([ideal * z[:, None], z])
    pixels = rig.cameras[name].project(rig.cam_from_core[name].apply(points))
    size = np.array(rig.cameras[name].size_px)
    inside = ((pixels > -50) & (pixels < size + 50)).all(axis=1)

    row = pack_projection(rig, name, unit, core_step, aux_step)
    assert row.dtype == np.float32
    assert row.shape == (39,)
    at = (np.stack([u, v]) - (core_step - 1) / 2) / core_step
    found_u, found_v, found_s = project(row, at[0], at[1], 1 / (z * unit))
    found = np.column_stack([found_u, found_v]) * aux_step + (aux_step - 1) / 2
    np.testing.assert_allclose(found[inside], pixels[inside], atol=1e-3)
    depth = rig.cam_from_core[name].apply(points)[:, 2]
    np.testing.assert_allclose(found_s, 1 / (depth * unit), rtol=1e-5)


@given(looking_rigs(), seeds)
def test_packed_projection_into_the_core_is_its_distortion(rig, seed):
    rng = np.random.default_rng(seed)
    camera = rig.core_camera
    u, v = rng.uniform(0, 1, (2, 20)) * np.array(camera.size_px)[:, None]
    ideal = (np.stack([u, v], axis=1) - camera.center_px) / camera.focal_px
    found = project(pack_projection(rig, rig.core, 1e-6), u, v, rng.uniform(0, 500, 20))[:2]
    np.testing.assert_allclose(
        np.stack(found, axis=1), camera.distort(ideal) * camera.focal_px + camera.center_px, atol=1e-3
    )


def make_two_cameras(center_mm: list[float]) -> Rig:
    camera = Camera("core", (640, 480), np.array([900.0, 1100.0]), np.array([320.0, 240]), np.zeros(5))
    poses = {"core": Pose.identity(), "aux": Pose.of(np.zeros(3), -np.array(center_mm))}
    return Rig("core", {"core": camera, "aux": camera}, poses)


@pytest.mark.parametrize(
    ("center_mm", "length_mm"),
    [
        ([200, 0, 0], 200),
        ([0, 150, 0], 150),
        ([120, -160, 50], 200),
        ([0, 0, 300], 300),
        ([3, 4, 300], 300.04),
    ],
)
def test_unit_is_a_pixel_of_disparity_for_the_baseline_across_the_axis(center_mm, length_mm):
    assert compute_inverse_depth_scale(make_two_cameras(center_mm), ["aux"]) == pytest.approx(
        1 / (1000 * length_mm), rel=1e-4
    )


def test_unit_moves_a_pixel_by_one_for_a_horizontal_baseline():
    rig = make_two_cameras([-200, 0, 0])
    unit = compute_inverse_depth_scale(rig, ["aux"])
    u = [
        project(pack_projection(rig, "aux", unit), np.full(1, 320.0), np.full(1, 240.0), np.full(1, s))[0][0]
        for s in (7, 8)
    ]
    assert u[1] - u[0] == pytest.approx(0.9, rel=1e-5)  # of the mean focal length, 1000; across it is 900


@pytest.mark.parametrize("name", ["left", "right"])
def test_kernels_project_pixels_like_the_rig(name):
    """In float32 on full frames: a spline whose coefficients are its columns' numbers has u as its value."""
    camera = Camera("core", (1224, 1024), np.full(2, 1160.0), np.array([609.3, 514.8]), LENS)
    poses = {"core": Pose.identity(), "left": Pose.of([0.03, 0.12, -0.02], [-140, 9, -20])}
    poses["right"] = Pose.of([-0.05, -0.15, 0.04], [170, -11, 15])
    rig = Rig("core", dict.fromkeys(poses, camera), poses)
    unit = compute_inverse_depth_scale(rig, rig.auxiliaries)
    z = np.random.default_rng(1).uniform(900, 1100, (1024, 1224))
    u, v = np.meshgrid(np.arange(1224.0), np.arange(1024.0))
    points = np.stack([(u - 609.3) / 1160 * z, (v - 514.8) / 1160 * z, z], axis=-1)
    pixels = camera.project(rig.cam_from_core[name].apply(points))
    for axis, ramp in enumerate((u, v)):
        value, _ = load().warp(1 / (z * unit), pack_projection(rig, name, unit), ramp)
        assert np.isfinite(value).mean() > 0.8
        error = np.abs(value - pixels[..., axis])
        assert np.nanmax(error) < 1e-3
