"""Resampling of the truth to another core camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.truth import resample_depth, resample_mask


def rig(focal: float = 300.0, center: tuple[float, float] = (79.5, 59.5)) -> Rig:
    camera = Camera("cam0", (160, 120), np.full(2, focal), np.array(center), np.zeros(5))
    return Rig("cam0", {"cam0": camera}, {"cam0": Pose.identity()})


def plane(camera: Camera) -> np.ndarray:
    """Depth of a tilted plane 0.3 x + 0.2 y + z = 700 mm."""
    rays = camera.rays()
    return 700 / (1 + rays @ [0.3, 0.2])


def test_the_same_camera_keeps_the_truth():
    depth = plane(rig().core_camera)
    depth[30:60, 40:70] -= 50
    depth[5, 5] = np.nan
    assert_allclose(resample_depth(rig(), rig(), depth), depth, rtol=1e-12)


def test_a_plane_stays_the_plane():
    found = rig(301.2, (80.1, 58.9))
    depth = resample_depth(found, rig(), plane(rig().core_camera))
    inside = np.isfinite(depth)
    assert inside.mean() > 0.97
    assert_allclose(depth[inside], plane(found.core_camera)[inside], atol=1e-9)


def test_nothing_is_mixed_at_a_step():
    depth = np.full((120, 160), 700.0)
    depth[:, 80:] = 600.0
    moved = resample_depth(rig(center=(79.9, 59.5)), rig(), depth)
    assert set(np.unique(moved[np.isfinite(moved)].round(9))) == {600.0, 700.0}


def test_a_mask_moves_by_whole_pixels_and_ends_with_the_truth():
    mask = np.ones((120, 160), bool)
    mask[:, 100:] = False
    moved = replace(rig(), cameras={"cam0": rig(center=(82.5, 59.5)).core_camera})
    seen = resample_mask(moved, rig(), mask)
    assert not seen[:, :3].any()
    assert seen[:, 3:103].all()
    assert not seen[:, 103:].any()
