"""Rigs: relative poses and projection."""

from __future__ import annotations

import numpy as np
from hypothesis import given

from tests.strategies import looking_rigs, rigs, seeds


@given(rigs(minimum=3))
def test_relative_poses_chain(rig):
    a, b, c = list(rig.cameras)[:3]
    direct, through = rig.relative_pose(c, a), rig.relative_pose(c, b) @ rig.relative_pose(b, a)
    np.testing.assert_allclose(direct.rotation, through.rotation, atol=1e-13)
    np.testing.assert_allclose(direct.translation_mm, through.translation_mm, atol=1e-8)


@given(rigs())
def test_relative_to_the_core_is_cam_from_core(rig):
    for name in rig.cameras:
        np.testing.assert_allclose(
            rig.relative_pose(name, rig.core).translation_mm, rig.cam_from_core[name].translation_mm
        )


@given(looking_rigs(), seeds)
def test_projection_gives_undistorted_pixels(rig, seed):
    point = np.random.default_rng(seed).uniform([-50, -50, 900], [50, 50, 1100])
    for name, camera in rig.cameras.items():
        u, v, w = rig.projection(name) @ [*point, 1.0]
        x, y, z = rig.cam_from_core[name].apply(point)
        np.testing.assert_allclose(
            [u / w, v / w], camera.focal_px * [x / z, y / z] + camera.center_px, atol=1e-8
        )


@given(rigs())
def test_auxiliaries_are_all_but_the_core(rig):
    assert rig.core not in rig.auxiliaries
    assert {rig.core, *rig.auxiliaries} == set(rig.cameras)
    assert rig.core_camera is rig.cameras[rig.core]
