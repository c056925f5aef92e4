"""Resection of a board: its pose from all cameras of a known rig that see it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.solver.lens import (
    ModelRows,
    count_usable_points,
    differentiate_by_pose,
    fit_view_pose,
    group_by_model,
    project_points,
    project_with_jacobians,
    rotate_vectors,
    stack_intrinsics,
)
from beltscape.calibration.solver.levenberg_marquardt import Damping, minimise
from beltscape.core.arrays import Array
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig


def fit_board_pose(rig: Rig, views: Mapping[str, Corners], board_mm: Array) -> Pose:
    """Fit the board's pose (core_from_board) to all cameras of one frame, with equal weights of all corners.

    ``board_mm`` (P, 3) are the board's corners in its own frame.
    """
    name = _select_reference(rig, views)
    corners = views[name]
    seen = fit_view_pose(rig.cameras[name], board_mm[corners.ids], corners.pixels)
    start = rig.cam_from_core[name].inverse() @ seen
    counts = [len(c) for c in views.values()]
    poses, cameras = [rig.cam_from_core[n] for n in views], [rig.cameras[n] for n in views]
    problem = ResectionProblem(
        group_by_model([camera.model for camera in cameras], np.repeat(np.arange(len(counts)), counts)),
        np.repeat(stack_intrinsics(cameras), counts, axis=0),
        np.repeat([np.column_stack([p.rotation, p.translation_mm]) for p in poses], counts, axis=0),
        np.concatenate([board_mm[c.ids] for c in views.values()]),
        np.concatenate([c.pixels for c in views.values()]),
    )
    return minimise(problem, start, Damping(tolerance=1e-12)).state


def _select_reference(rig: Rig, views: Mapping[str, Corners]) -> str:
    """Return the camera with the most corners within its lens's domain, the first of equal ones."""
    ordered = sorted(views, key=lambda name: -len(views[name]))
    best, most = ordered[0], -1
    for name in ordered:
        if len(views[name]) <= most:
            break
        count = count_usable_points(rig.cameras[name], views[name].pixels)
        if count > most:
            best, most = name, count
    return best


class ResectionProblem:
    """Reprojection errors of one board with equal weights, as a problem for `levenberg_marquardt.minimise`."""

    def __init__(
        self, models: ModelRows, lenses: Array, cam_from_core: Array, points_mm: Array, pixels: Array
    ) -> None:
        """Set up the problem by corner.

        The rows of each lens model, (N, W) intrinsics, (N, 3, 4) camera pose, (N, 3) on the board, (N, 2) pixels.
        """
        self.models, self.lenses, self.points_mm, self.pixels = models, lenses, points_mm, pixels
        self.rotations, self.shifts = cam_from_core[:, :, :3], cam_from_core[:, :, 3]

    def compute_cost(self, state: Pose) -> float:
        """Return half the sum of squares."""
        errors = (
            project_points(self._transform_to_cameras(state.apply(self.points_mm)), self.lenses, self.models)
            - self.pixels
        )
        return 0.5 * float((errors**2).sum())

    def linearise(self, state: Pose) -> LinearisedResection:
        """Return errors and their derivatives by rotation and translation of the board in the core frame."""
        on_board = self.points_mm @ state.rotation.T
        pixels, by_point, _ = project_with_jacobians(
            self._transform_to_cameras(on_board + state.translation_mm), self.lenses, self.models
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
