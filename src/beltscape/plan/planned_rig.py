"""The planned rig: the core vertically above the belt, the auxiliaries around it, all aimed at one point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig
from beltscape.plan.settings import CameraSettings, PlanSettings

CORE_FROM_WORLD = np.diag([1.0, -1.0, -1.0])
"""Rotation of a camera that looks vertically down, its rows across the belt."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedRig:
    """A rig in the world: x across the belt, y along it, z up, mm; origin on its level middle below the core."""

    rig: Rig
    core_from_world: Pose
    baseline_mm: float
    tilt_rad: float
    """Angle between the optical axes of an auxiliary and the core."""
    target_mm: NDArray[np.float64]
    """(3,) the point where all axes meet."""

    def cam_from_world(self, name: str) -> Pose:
        """Return the pose of one camera."""
        return self.rig.cam_from_core[name] @ self.core_from_world

    def position_mm(self, name: str) -> NDArray[np.float64]:
        """Return (3,) the position of one camera in the world."""
        return self.cam_from_world(name).center_mm

    def project(self, name: str, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (..., 2) pixels of world points (..., 3) in a camera."""
        return self.rig.cameras[name].project(self.cam_from_world(name).apply(points_mm))

    def sees(self, name: str, points_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return (...) whether world points (..., 3) project into the image of a camera."""
        pixels = self.project(name, points_mm)
        inside = (pixels >= -0.5) & (pixels <= np.array(self.rig.cameras[name].size_px) - 0.5)
        return np.asarray(inside.all(axis=-1))


def make_planned_rig(settings: PlanSettings, height_mm: float, baseline_mm: float) -> PlannedRig:
    """Return the core at ``height_mm`` and auxiliaries level with it at 360°/n, tilted to the middle of the load.

    An auxiliary is the core rotated about the one horizontal axis that turns its optical axis towards the point,
    so that all images have the same orientation.
    """
    middle = sum(settings.belt.material_mm) / 2
    target = np.array([0.0, 0.0, middle])
    tilt = float(np.arctan2(baseline_mm, height_mm - middle))
    core_from_world = Pose(CORE_FROM_WORLD.copy(), np.array([0.0, 0.0, height_mm]))
    cameras = {"cam0": _make_camera("cam0", settings.camera)}
    poses = {"cam0": Pose.identity()}
    count = settings.rig.auxiliaries
    for i in range(count):
        name = f"cam{i + 1}"
        angle = np.deg2rad(settings.rig.first_deg) + 2 * np.pi * i / count
        across, along = np.cos(angle), np.sin(angle)
        # in the core's axes (image y opposite to the belt's y) the camera is at (across, -along)
        cam_from_core = rotation_from_vector(tilt * np.array([along, across, 0.0]))
        poses[name] = Pose(cam_from_core, -cam_from_core @ (baseline_mm * np.array([across, -along, 0.0])))
        cameras[name] = _make_camera(name, settings.camera)
    quality = {"planned": True, "height_mm": height_mm, "baseline_mm": baseline_mm}
    return PlannedRig(Rig("cam0", cameras, poses, quality), core_from_world, baseline_mm, tilt, target)


def _make_camera(name: str, settings: CameraSettings) -> Camera:
    """Return the nominal camera: the lens's focal length, a centred principal point, no distortion."""
    size = settings.size_px
    return Camera(
        name, size, np.full(2, settings.focal_px), (np.array(size, np.float64) - 1) / 2, np.zeros(5)
    )
