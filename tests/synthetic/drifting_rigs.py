"""A rig over a belt whose cameras move by known amounts, and tie points of the material under it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.drift import DriftAccumulator, DriftWindow, apply_drift
from beltscape.stereo.consistency.tie_points import TiePoints

SIZE_PX = (1224, 1024)
BELT_MM = 900.0
NOISE_PX = 0.25
FRAMES = 24


@lru_cache
def make_rig() -> Rig:
    """The rig as it was calibrated: a core and four cameras around it that look at the belt's middle."""
    names = [f"cam{number}" for number in range(5)]
    lens = np.array([-0.1, 0.05, 0.0, 0.0, 0.0])
    cameras = {
        name: Camera(name, SIZE_PX, np.full(2, 1400.0), (np.array(SIZE_PX) - 1) / 2, lens) for name in names
    }
    poses = {"cam0": Pose.identity()}
    for name, (x, y) in zip(names[1:], [(150, 0), (-150, 0), (0, 120), (0, -120)], strict=True):
        rotation = Pose.of(np.array([-y / 800, x / 800, 0.0]), np.zeros(3)).rotation
        poses[name] = Pose(rotation, rotation @ -np.array([x, y, 0.0]))
    return Rig("cam0", cameras, poses)


@lru_cache
def make_true_rig() -> Rig:
    """The rig as it truly is: calibrations err, too."""
    rng = np.random.default_rng(0)
    error = [2e-4, 2e-4, 2e-4, 0.05, 0.05, 0.05, 2e-4]
    return apply_drift(make_rig(), {name: rng.normal(size=7) * error for name in make_rig().auxiliaries})


def find_points(true: Rig, rng: np.random.Generator, count: int = 250) -> TiePoints:
    """Points of a load of up to 120 mm, and of the belt beside it, with noise and missing ones."""
    rig = make_rig()
    depth = BELT_MM - rng.uniform(0, 120, count) * (rng.random(count) < 0.7)
    points = np.column_stack([rng.uniform([-330, -270], [330, 270], (count, 2)), depth])
    nominal = rig.core_camera
    seen = true.core_camera.project(points) + 0.3 * NOISE_PX * rng.normal(size=(count, 2))
    core = nominal.undistort(seen) * nominal.focal_px + nominal.center_px
    inside = ((core >= 0) & (core <= np.array(SIZE_PX) - 1)).all(axis=1)
    observed = {}
    for name in rig.auxiliaries:
        pixels = true.cameras[name].project(true.cam_from_core[name].apply(points))
        pixels += NOISE_PX * rng.normal(size=(count, 2))
        lost = ((pixels < 0) | (pixels > np.array(SIZE_PX) - 1)).any(axis=1) | (rng.random(count) < 0.15)
        pixels[lost] = np.nan
        observed[name] = pixels[inside]
    searched = {name: np.ones(int(inside.sum()), np.bool_) for name in observed}
    return TiePoints(core[inside], 1 / depth[inside], observed, searched)


def make_window(true: Rig, seed: int, frames: int = FRAMES) -> DriftWindow:
    """The window of frames of the belt under a true rig, by the calibrated one."""
    rng, accumulator = np.random.default_rng(seed), DriftAccumulator(make_rig())
    for _ in range(frames):
        accumulator.add(find_points(true, rng))
    return accumulator.close()


@lru_cache
def make_reference() -> DriftWindow:
    """The first window, before anything moves."""
    return make_window(make_true_rig(), 1)
