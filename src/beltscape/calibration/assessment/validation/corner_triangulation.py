"""Triangulation of board corners with the least reprojection error, without assuming a board."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.solver.lens import pack_intrinsics
from beltscape.calibration.solver.projection import project_points, project_with_jacobians
from beltscape.core.geometry.rig import Rig
from beltscape.kernels import Kernels

Array = NDArray[np.float64]

STEPS = 3
"""Gauss-Newton steps from the linear solution, which is near the minimum: the third moves it by below 1e-6 mm."""
DAMPING = 1e-9
"""Share of the normal matrix's trace that keeps it invertible for nearly parallel rays."""


def triangulate_corners(rig: Rig, views: Mapping[str, Corners], count: int, kernels: Kernels) -> Array:
    """Triangulate corners (count, 3) in the core frame, mm; NaN where fewer than two cameras see one.

    The linear solution (Eqs. 2-3), which minimises no error in the images, is the start of Gauss-Newton steps on the
    reprojection errors in the distorted images (Hartley & Zisserman, Multiple View Geometry, 2004, Section 12.3).
    """
    pixels = np.full((len(views), count, 2), np.nan)
    ideal = pixels.copy()
    for i, (name, corners) in enumerate(views.items()):
        camera = rig.cameras[name]
        pixels[i, corners.ids] = corners.pixels
        ideal[i, corners.ids] = camera.undistort(corners.pixels) * camera.focal_px + camera.center_px
    pixels[np.isnan(ideal)] = np.nan  # beyond the lens's domain of validity
    points = kernels.triangulate(np.stack([rig.projection(name) for name in views]), ideal, threads=1)
    known = np.flatnonzero(np.isfinite(points).all(axis=1))
    refined = points[known]
    for _ in range(STEPS):
        refined = _step(rig, tuple(views), refined, pixels[:, known])
    points[known] = refined
    return points


def _step(rig: Rig, names: tuple[str, ...], points: Array, pixels: Array) -> Array:
    """Return points (n, 3) after a Gauss-Newton step, where it lowers the squared errors."""
    normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    for name, seen in zip(names, pixels, strict=True):
        camera, pose = rig.cameras[name], rig.cam_from_core[name]
        lens = np.tile(pack_intrinsics(camera), (len(points), 1))
        projected, by_point, _ = project_with_jacobians(pose.apply(points), lens, camera.model)
        visible = np.isfinite(seen[:, :1])
        jacobian = np.where(visible[..., None], by_point @ pose.rotation, 0.0)
        normal += np.einsum("nri,nrj->nij", jacobian, jacobian)
        right += np.einsum("nri,nr->ni", jacobian, np.where(visible, seen - projected, 0.0))
    normal += DAMPING * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    moved: Array = points + np.asarray(np.linalg.solve(normal, right[..., None]), np.float64)[..., 0]
    better = _compute_cost(rig, names, moved, pixels) <= _compute_cost(rig, names, points, pixels)
    return np.where(better[:, None], moved, points)


def _compute_cost(rig: Rig, names: tuple[str, ...], points: Array, pixels: Array) -> Array:
    """Return the sum (n,) of the squared reprojection errors of points (n, 3) over all cameras that see them."""
    total = np.zeros(len(points))
    for name, seen in zip(names, pixels, strict=True):
        camera = rig.cameras[name]
        lens = np.tile(pack_intrinsics(camera), (len(points), 1))
        projected = project_points(rig.cam_from_core[name].apply(points), lens, camera.model)
        total += np.where(np.isfinite(seen[:, 0]), ((projected - seen) ** 2).sum(axis=1), 0.0)
    return total
