"""What the calibration's covariance does to a measured depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.adjust import Adjusted
from beltscape.calibrate.bundle import INTRINSICS
from beltscape.calibrate.jacobian import by_pose, project
from beltscape.calibrate.lens import intrinsics
from beltscape.core.rig import Rig

Array = NDArray[np.float64]

NAMES = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
POSE = ("turn_x_rad", "turn_y_rad", "turn_z_rad", "shift_x_mm", "shift_y_mm", "shift_z_mm")


@dataclass(frozen=True, slots=True, eq=False)
class RigCovariance:
    """Covariance of a rig's parameters; a held parameter has variance 0."""

    parameters: tuple[str, ...]
    """``camera.parameter``: intrinsics of every camera, then the pose of every camera but the core.

    A pose's turn is about the axes of the camera's own frame: ``exp(turn) @ rotation``, ``translation + shift``.
    """
    matrix: Array
    """(G, G)."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthSigma:
    """One standard deviation of a triangulated depth from calibration alone, over the core camera's view."""

    depth_mm: float
    x_mm: Array
    """(Nx,) in the core frame."""
    y_mm: Array
    """(Ny,)."""
    sigma_mm: Array
    """(Ny, Nx); NaN where fewer than two cameras see the point."""


def rig_covariance(adjusted: Adjusted) -> RigCovariance:
    """Covariance of the cameras' parameters, everything else marginalised."""
    cameras = list(adjusted.rig.cameras)
    names = [f"{name}.{what}" for name in cameras for what in NAMES]
    names += [f"{name}.{what}" for name in cameras if name != adjusted.rig.core for what in POSE]
    free = adjusted.bundle.free
    of_cameras = free[free < adjusted.bundle.point_start]
    full = np.zeros((len(names), len(names)))
    own = adjusted.linear().covariance()[: len(of_cameras), : len(of_cameras)]
    full[np.ix_(of_cameras, of_cameras)] = (own + own.T) / 2
    return RigCovariance(tuple(names), full)


def depth_sigma(rig: Rig, covariance: Array, depth_mm: float, *, columns: int = 31) -> DepthSigma:
    """σ of depths triangulated at ``depth_mm`` in front of the core, propagated from (G, G) to first order."""
    width, height = rig.core_camera.size_px
    rows = max(3, round(columns * height / width))
    corner = (np.array(rig.core_camera.size_px) - 1 - rig.core_camera.center_px) / rig.core_camera.focal_px
    origin = -rig.core_camera.center_px / rig.core_camera.focal_px
    x = np.linspace(origin[0], corner[0], columns) * depth_mm
    y = np.linspace(origin[1], corner[1], rows) * depth_mm
    grid_x, grid_y = np.meshgrid(x, y)
    points = np.stack([grid_x.ravel(), grid_y.ravel(), np.full(grid_x.size, depth_mm)], axis=-1)
    return DepthSigma(depth_mm, x, y, _sigma_z(rig, covariance, points).reshape(rows, columns))


def _sigma_z(rig: Rig, covariance: Array, points_mm: Array) -> Array:
    """(N,) σ of the depth of points triangulated by all cameras that see them.

    The triangulated point moves by −(Σ JᵀJ)⁻¹ Σ Jᵀ ∂π/∂θ δθ when the parameters move by δθ.
    """
    count = len(covariance)
    normal, mixed = np.zeros((len(points_mm), 3, 3)), np.zeros((len(points_mm), 3, count))
    seen_by = np.zeros(len(points_mm))
    start = INTRINSICS * len(rig.cameras)
    for i, (name, camera) in enumerate(rig.cameras.items()):
        pose = rig.cam_from_core[name]
        turned = points_mm @ pose.rotation.T
        inside = turned + pose.translation_mm
        lens = np.tile(intrinsics(camera), (len(points_mm), 1))
        pixels, by_point, by_lens = project(inside, lens)
        seen = ((pixels >= 0) & (pixels <= np.array(camera.size_px) - 1)).all(axis=1) & (inside[:, 2] > 0)
        jacobian = np.einsum("nij,jk->nik", by_point, pose.rotation) * seen[:, None, None]
        normal += np.einsum("nri,nrj->nij", jacobian, jacobian)
        columns = slice(INTRINSICS * i, INTRINSICS * (i + 1))
        mixed[:, :, columns] += np.einsum("nri,nrj->nij", jacobian, by_lens)
        if i > 0:
            columns = slice(start + 6 * (i - 1), start + 6 * i)
            mixed[:, :, columns] += np.einsum("nri,nrj->nij", jacobian, by_pose(by_point, turned))
        seen_by += seen
    usable = seen_by >= 2
    sigma = np.full(len(points_mm), np.nan)
    moves = np.linalg.solve(normal[usable], mixed[usable])[:, 2]
    sigma[usable] = np.sqrt(np.einsum("ni,ij,nj->n", moves, covariance, moves))
    return sigma
