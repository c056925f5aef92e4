"""Next-best view: the board pose that lowers the standard deviation of depth most."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from beltscape.calibration.assessment.covariance import (
    RigCovariance,
    compute_depth_jacobian,
    count_parameters,
    differentiate_camera,
    list_parameter_columns,
    make_view_points,
)
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.core.arrays import Array
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig

TILT_RAD = np.deg2rad(35.0)
"""Tilt of the tried boards; below the 45° at which Zhang (2000) finds the least error, since corners foreshorten."""
CENTERS = (-0.3, 0.0, 0.3)
"""Board centres, in widths and heights of the core camera's view."""
DISTANCES = (0.85, 1.15)
"""In units of the boards' usual distance."""
TILTS = {
    "": (0.0, 0.0),
    "top away": (-1.0, 0.0),
    "top near": (1.0, 0.0),
    "left away": (0.0, 1.0),
    "left near": (0.0, -1.0),
}
MIN_GAIN = 0.05
"""Least relative decrease of σ for which a further view is recommended."""
_VIEW_POINTS = 13
"""Rows and columns of the points of the core's view over which σ of depth is averaged. Chosen."""
MIN_CORNERS = 8
"""Least number of visible corners for a camera to see the board."""


@dataclass(frozen=True, slots=True, eq=False)
class NextBestView:
    """The most useful next view of the board."""

    core_from_board: Pose
    seen_by: tuple[str, ...]
    sigma_now_mm: float
    """RMS depth σ over the core's view at the boards' usual distance."""
    sigma_then_mm: float
    """RMS depth σ with this view added."""
    placement: str
    """Description of the board's pose."""

    @property
    def is_sufficient(self) -> bool:
        """Return whether the present views suffice, because even this one lowers σ by little."""
        return self.sigma_then_mm > (1 - MIN_GAIN) * self.sigma_now_mm

    def describe(self) -> str:
        """Return the recommendation in one sentence."""
        if self.is_sufficient:
            gain = 1 - self.sigma_then_mm / self.sigma_now_mm
            return f"Enough views: the most useful further one would lower the depth σ by {gain:.1%} only."
        digits = max(3, 2 - int(np.floor(np.log10(self.sigma_then_mm))))  # three that count: the two differ
        return (
            f"Next, hold the board {self.placement}, so that {', '.join(self.seen_by)} see it: the depth σ would "
            f"fall from {self.sigma_now_mm:.{digits}f} to {self.sigma_then_mm:.{digits}f} mm."
        )


def find_next_best_view(adjustment: BundleAdjustmentResult, covariance: RigCovariance) -> NextBestView | None:
    """Return the best of a grid of board positions, distances and tilts; None if two cameras see none of them.

    A view adds the information of its corners with its own pose marginalised; the best view leaves the smallest mean
    variance of depth.
    """
    rig, geometry = adjustment.rig, adjustment.geometry
    distance = float(np.median(geometry.board_translation_mm[:, 2]))
    free = np.flatnonzero(np.diag(covariance.matrix) > 0)
    information = np.linalg.inv(covariance.matrix[np.ix_(free, free)])
    sigma_px = covariance.inflation * adjustment.sigma_px
    points = make_view_points(rig, distance, _VIEW_POINTS)
    jacobian = compute_depth_jacobian(rig, points)
    jacobian = jacobian[np.isfinite(jacobian).all(axis=1)][:, free]
    if not len(jacobian):
        return None
    weight = jacobian.T @ jacobian / len(jacobian)
    now = float(np.sqrt(np.trace(weight @ np.linalg.inv(information))))
    best: NextBestView | None = None
    for pose, placement in _list_candidates(rig, geometry.points_mm, distance):
        added, seen_by = _compute_information(
            rig, pose.apply(geometry.points_mm), pose, geometry.points_mm, sigma_px
        )
        if len(seen_by) < 2:
            continue
        then = float(np.sqrt(np.trace(weight @ np.linalg.inv(information + added[np.ix_(free, free)]))))
        if best is None or then < best.sigma_then_mm:
            best = NextBestView(pose, seen_by, now, then, placement)
    return best


def _list_candidates(rig: Rig, corners_mm: Array, distance_mm: float) -> list[tuple[Pose, str]]:
    """Return candidate poses of the board with their descriptions."""
    middle = (corners_mm.min(axis=0) + corners_mm.max(axis=0)) / 2
    camera = rig.core_camera
    candidates: list[tuple[Pose, str]] = []
    for (u, v), share, (tilt, turns) in product(product(CENTERS, CENTERS), DISTANCES, TILTS.items()):
        depth = share * distance_mm
        pixel = (np.array([u, v]) + 0.5) * np.array(camera.size_px)
        center = np.append((pixel - camera.center_px) / camera.focal_px, 1.0) * depth
        rotation = rotation_from_vector(TILT_RAD * np.array([*turns, 0.0]))
        candidates.append(
            (Pose.placing(rotation, middle, center), _describe_placement(u, v, depth, tilt, rig.core))
        )
    return candidates


def _describe_placement(u: float, v: float, depth_mm: float, tilt: str, core: str) -> str:
    row = "upper" if v < 0 else "lower" if v > 0 else ""
    column = "left" if u < 0 else "right" if u > 0 else "middle"
    place = f"{row} {column}".strip()
    tilted = f"tilted {np.rad2deg(TILT_RAD):.0f}° with its {tilt}" if tilt else "square to the camera"
    return f"in the {place} of {core}'s view, {depth_mm:.0f} mm away, {tilted}"


def _compute_information(
    rig: Rig, points_mm: Array, pose: Pose, corners_mm: Array, sigma_px: Array
) -> tuple[Array, tuple[str, ...]]:
    """Return the information (G, G) of a view of the board at an unknown ``pose``, and the cameras that see it."""
    count = count_parameters(rig)
    shared: list[Array] = []
    boards: list[Array] = []
    seen_by: list[str] = []
    on_board = corners_mm @ pose.rotation.T
    for i, name in enumerate(rig.cameras):
        by_point, by_rig, visible = differentiate_camera(rig, name, points_mm)
        if visible.sum() < MIN_CORNERS:
            continue
        columns = list_parameter_columns(rig, i)
        block = np.zeros((int(visible.sum()), 2, count))
        block[:, :, columns] = by_rig[visible][:, :, : len(columns)] / sigma_px[i]
        shared.append(block.reshape(-1, count))
        turn = np.cross(on_board[visible][:, None, :], by_point[visible])
        boards.append((np.concatenate([turn, by_point[visible]], axis=-1) / sigma_px[i]).reshape(-1, 6))
        seen_by.append(name)
    if not seen_by:
        return np.zeros((count, count)), ()
    j, b = np.concatenate(shared), np.concatenate(boards)
    mixed = j.T @ b
    return j.T @ j - mixed @ np.linalg.solve(b.T @ b, mixed.T), tuple(seen_by)
