"""Pixels that are occluded in every auxiliary."""

from __future__ import annotations

import numpy as np

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.truth import occluded_mask
from beltscape.kernels import load

SIZE = (200, 40)


def rig(*baselines_mm: float) -> Rig:
    """Parallel cameras of 300 px focal length, the core in the middle."""
    names = ["cam0", *(f"cam{i + 1}" for i in range(len(baselines_mm)))]
    cameras = {n: Camera(n, SIZE, np.full(2, 300.0), np.array([99.5, 19.5]), np.zeros(5)) for n in names}
    shifts = [0.0, *baselines_mm]
    return Rig(
        "cam0",
        cameras,
        {n: Pose(np.eye(3), np.array([-x, 0.0, 0.0])) for n, x in zip(names, shifts, strict=True)},
    )


def bar_before_a_wall() -> np.ndarray:
    """A wall at 1 m, 30 px of disparity to a camera 100 mm beside; a bar at half that distance, 60 px."""
    depth = np.full(SIZE[::-1], 1000.0)
    depth[:, 100:120] = 500.0
    return depth


def test_occluded_and_out_of_view_pixels_are_masked():
    hidden = occluded_mask(rig(100), bar_before_a_wall(), load())
    expected = np.zeros(SIZE[0], bool)
    expected[:30] = True  # left of the auxiliary's image
    expected[70:90] = True  # where the bar, seen 60 px further left, covers the wall seen 30 px further left
    different = (hidden != expected).mean(axis=0) > 0
    assert not different[np.r_[0:29, 32:68, 72:88, 92:200]].any()  # a cast pixel is two wide


def test_pixels_visible_in_one_auxiliary_are_not_occluded():
    hidden = occluded_mask(rig(100, -100), bar_before_a_wall(), load())
    assert not hidden[:, 32:168].any()
    assert not hidden[:, 100:120].any()


def test_pixels_without_truth_are_not_counted():
    depth = bar_before_a_wall()
    depth[:, 75:80] = np.nan
    assert not occluded_mask(rig(100), depth, load())[:, 75:80].any()
