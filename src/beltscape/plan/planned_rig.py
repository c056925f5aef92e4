"""The planned rig: the core vertically above the belt, the auxiliaries around it, all aimed at one point.

Its standard deviation of depth is predicted: matching noise propagated through the projections of all cameras.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
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
    _cams_from_world: Mapping[str, Pose] = field(init=False, repr=False)
    """The pose of each camera, which the search for the covered length asks for thousands of times."""

    def __post_init__(self) -> None:
        """Compute the cameras' poses in the world."""
        poses = {name: pose @ self.core_from_world for name, pose in self.rig.cam_from_core.items()}
        object.__setattr__(self, "_cams_from_world", poses)

    def cam_from_world(self, name: str) -> Pose:
        """Return the pose of one camera."""
        return self._cams_from_world[name]

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


_NODES = 61
"""Nodes of the map across the belt; along it they are as dense. The σ is smooth between them."""
_LEAST_NODES = 9
"""Least number of nodes along the belt, for short pieces."""


@dataclass(frozen=True, slots=True, eq=False)
class SigmaMap:
    """One standard deviation of the height over a level plane."""

    height_mm: float
    x_mm: Array
    """(Nx,) across the belt."""
    y_mm: Array
    """(Ny,) along the belt."""
    sigma_mm: Array
    """(Ny, Nx); NaN where the core or all auxiliaries do not see the point."""
    cameras: NDArray[np.int64]
    """(Ny, Nx) number of cameras that see the point."""


def predict_sigma_mm(
    planned: PlannedRig, points_mm: Array, sigma_px: float, calibration_mm: float = 0.0
) -> Array:
    """Return (N,) σ of the height of world points (N, 3), triangulated by all cameras that see them.

    With J the derivative of a camera's pixel by the point, the point's covariance is σ²(Σ JᵀJ)⁻¹ for independent
    noise of ``sigma_px`` on either coordinate of every camera (Gauss–Markov). The calibration's σ is added in
    quadrature. NaN where fewer than two cameras, or not the core, see the point.
    """
    normal, views = np.zeros((len(points_mm), 3, 3)), np.zeros(len(points_mm), np.int64)
    for name, camera in planned.rig.cameras.items():
        is_seen = planned.sees(name, points_mm)
        jacobian = (
            projection_jacobian(camera, planned.cam_from_world(name), points_mm) * is_seen[:, None, None]
        )
        normal += np.einsum("nri,nrj->nij", jacobian, jacobian)
        views += is_seen
    is_measurable = (views >= 2) & planned.sees(planned.rig.core, points_mm)
    result = np.full(len(points_mm), np.nan)
    result[is_measurable] = np.hypot(
        sigma_px * np.sqrt(np.linalg.inv(normal[is_measurable])[:, 2, 2]), calibration_mm
    )
    return result


def projection_jacobian(camera: Camera, cam_from_world: Pose, points_mm: Array) -> Array:
    """Return (N, 2, 3) derivative of a distortion-free camera's pixels by world points (N, 3), px/mm."""
    x, y, z = cam_from_world.apply(points_mm).T
    zero = np.zeros_like(z)
    fx, fy = camera.focal_px
    jacobian = np.array([[fx / z, zero, -fx * x / z**2], [zero, fy / z, -fy * y / z**2]])
    return np.einsum("rin,ij->nrj", jacobian, cam_from_world.rotation)


def predict_sigma_map(
    settings: PlanSettings, planned: PlannedRig, height_mm: float, length_mm: float
) -> SigmaMap:
    """Return σ over the span and ``length_mm`` of belt, at one height."""
    half = settings.belt.span_mm / 2
    x = np.linspace(-half, half, _NODES)
    along = max(_LEAST_NODES, round((_NODES - 1) * length_mm / (2 * half)) | 1)
    y = np.linspace(-length_mm / 2, length_mm / 2, along)
    points = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), height_mm)], axis=-1).reshape(-1, 3)
    precision = settings.precision
    sigma = predict_sigma_mm(planned, points, precision.sigma_px, precision.calibration_sigma_mm)
    views = sum(planned.sees(name, points).astype(np.int64) for name in planned.rig.cameras)
    shape = (len(y), len(x))
    return SigmaMap(height_mm, x, y, sigma.reshape(shape), np.asarray(views).reshape(shape))
