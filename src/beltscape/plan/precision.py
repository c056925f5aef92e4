"""The predicted standard deviation of depth: matching noise propagated through the projections of all cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.plan.planned_rig import PlannedRig
from beltscape.plan.settings import PlanSettings

_NODES = 61
"""Nodes of the map across the belt; along it they are as dense. The σ is smooth between them."""
_LEAST_NODES = 9
"""Least number of nodes along the belt, for short pieces."""

Array = NDArray[np.float64]


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
