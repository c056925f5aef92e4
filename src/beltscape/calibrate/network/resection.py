"""Resection of a board: its pose from all cameras of a known rig that see it."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.detection.corners import Corners
from beltscape.calibrate.solver.lens import pack_intrinsics
from beltscape.calibrate.solver.levenberg_marquardt import Damping, minimise
from beltscape.calibrate.solver.projection import (
    differentiate_by_pose,
    project_points,
    project_with_jacobians,
    rotate_vectors,
)
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig

Array = NDArray[np.float64]


def fit_board_pose(rig: Rig, views: Mapping[str, Corners], board_mm: Array) -> Pose:
    """Fit the board's pose (core_from_board) to all cameras of one frame, with equal weights of all corners.

    ``board_mm`` (P, 3) are the board's corners in its own frame.
    """
    name = max(views, key=lambda n: len(views[n]))
    corners, camera = views[name], rig.cameras[name]
    ideal = camera.undistort(corners.pixels)
    _, rotation, translation = cv2.solvePnP(
        board_mm[corners.ids], ideal, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
    )
    start = rig.cam_from_core[name].inverse() @ Pose.of(rotation, translation)
    counts = [len(c) for c in views.values()]
    poses = [rig.cam_from_core[n] for n in views]
    problem = ResectionProblem(
        np.repeat([pack_intrinsics(rig.cameras[n]) for n in views], counts, axis=0),
        np.repeat([np.column_stack([p.rotation, p.translation_mm]) for p in poses], counts, axis=0),
        np.concatenate([board_mm[c.ids] for c in views.values()]),
        np.concatenate([c.pixels for c in views.values()]),
    )
    return minimise(problem, start, Damping(tolerance=1e-12)).state


class ResectionProblem:
    """Reprojection errors of one board with equal weights, as a problem for `levenberg_marquardt.minimise`."""

    def __init__(self, lenses: Array, cam_from_core: Array, points_mm: Array, pixels: Array) -> None:
        """Set up the problem by corner: (N, 9) intrinsics, (N, 3, 4) camera pose, (N, 3) on the board, (N, 2)."""
        self.lenses, self.points_mm, self.pixels = lenses, points_mm, pixels
        self.rotations, self.shifts = cam_from_core[:, :, :3], cam_from_core[:, :, 3]

    def compute_cost(self, state: Pose) -> float:
        """Return half the sum of squares."""
        errors = (
            project_points(self._transform_to_cameras(state.apply(self.points_mm)), self.lenses) - self.pixels
        )
        return 0.5 * float((errors**2).sum())

    def linearise(self, state: Pose) -> LinearisedResection:
        """Return errors and their derivatives by rotation and translation of the board in the core frame."""
        on_board = self.points_mm @ state.rotation.T
        pixels, by_point, _ = project_with_jacobians(
            self._transform_to_cameras(on_board + state.translation_mm), self.lenses
        )
        jacobian = differentiate_by_pose(by_point @ self.rotations, on_board).reshape(-1, 6)
        return LinearisedResection((pixels - self.pixels).ravel(), jacobian)

    def apply_step(self, state: Pose, step: Array) -> Pose:
        """Return the pose after a step."""
        return Pose(rotation_from_vector(step[:3]) @ state.rotation, state.translation_mm + step[3:])

    def _transform_to_cameras(self, in_core: Array) -> Array:
        return rotate_vectors(self.rotations, in_core) + self.shifts


class LinearisedResection:
    """The six normal equations of a resection."""

    def __init__(self, errors: Array, jacobian: Array) -> None:
        self.cost = 0.5 * float(errors @ errors)
        self._hessian, self._gradient = jacobian.T @ jacobian, jacobian.T @ errors

    def solve_step(self, damping: float) -> Array:
        """Return the damped step of Eq. 19 with Marquardt's scaling."""
        damped = self._hessian + damping * np.diag(np.diag(self._hessian))
        return np.asarray(-np.linalg.solve(damped, self._gradient), np.float64)

    def predict_decrease(self, step: Array) -> float:
        """Return F(X) − L(X + δ)."""
        return -float(self._gradient @ step + 0.5 * step @ self._hessian @ step)
