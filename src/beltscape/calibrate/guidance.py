"""Which board pose to take next: the one that lowers the depth's standard deviation most."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.adjust import Adjusted
from beltscape.calibrate.uncertainty import (
    RigCovariance,
    camera_derivatives,
    depth_moves,
    parameter_columns,
    view_points,
)
from beltscape.core.pose import Pose, rotation_from_vector
from beltscape.core.rig import Rig

Array = NDArray[np.float64]

TILT_RAD = np.deg2rad(35.0)
PLACES = (-0.3, 0.0, 0.3)
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
ENOUGH = 0.05
"""A view that lowers σ by less than this share is not worth taking."""
MIN_CORNERS = 8


@dataclass(frozen=True, slots=True, eq=False)
class NextPose:
    """The most useful next view of the board."""

    core_from_board: Pose
    seen_by: tuple[str, ...]
    sigma_now_mm: float
    """RMS depth σ over the core's view at the boards' usual distance."""
    sigma_then_mm: float
    """The same with this view added."""
    words: str
    """Where to hold the board."""

    @property
    def enough(self) -> bool:
        """Whether even this view would hardly help."""
        return self.sigma_then_mm > (1 - ENOUGH) * self.sigma_now_mm

    def describe(self) -> str:
        """In a sentence."""
        if self.enough:
            gain = 1 - self.sigma_then_mm / self.sigma_now_mm
            return f"Enough views: the most useful further one would lower the depth σ by {gain:.1%} only."
        return (
            f"Next, hold the board {self.words}, so that {', '.join(self.seen_by)} see it: the depth σ would fall "
            f"from {self.sigma_now_mm:.3f} to {self.sigma_then_mm:.3f} mm."
        )


def next_pose(adjusted: Adjusted, covariance: RigCovariance) -> NextPose | None:
    """Try the board at places, distances and tilts over the core's view; None where no camera would see it.

    A view adds the information of its corners, less what its own unknown pose takes; the best one leaves the
    smallest mean variance of depth.
    """
    rig, geometry = adjusted.rig, adjusted.geometry
    distance = float(np.median(geometry.board_translation_mm[:, 2]))
    free = np.flatnonzero(np.diag(covariance.matrix) > 0)
    information = np.linalg.inv(covariance.matrix[np.ix_(free, free)])
    sigma_px = covariance.inflation * adjusted.sigma_px
    points = view_points(rig, distance, 13)
    moves = depth_moves(rig, points)
    moves = moves[np.isfinite(moves).all(axis=1)][:, free]
    if not len(moves):
        return None
    weight = moves.T @ moves / len(moves)
    now = float(np.sqrt(np.trace(weight @ np.linalg.inv(information))))
    best: NextPose | None = None
    for pose, words in _candidates(rig, geometry.points_mm, distance):
        added, seen_by = _information(rig, pose.apply(geometry.points_mm), pose, geometry.points_mm, sigma_px)
        if len(seen_by) < 2:
            continue
        then = float(np.sqrt(np.trace(weight @ np.linalg.inv(information + added[np.ix_(free, free)]))))
        if best is None or then < best.sigma_then_mm:
            best = NextPose(pose, seen_by, now, then, words)
    return best


def _candidates(rig: Rig, corners_mm: Array, distance_mm: float) -> list[tuple[Pose, str]]:
    """Poses of the board and where they are, in words."""
    middle = (corners_mm.min(axis=0) + corners_mm.max(axis=0)) / 2
    camera = rig.core_camera
    found = []
    for (u, v), share, (tilt, turns) in product(product(PLACES, PLACES), DISTANCES, TILTS.items()):
        depth = share * distance_mm
        pixel = (np.array([u, v]) + 0.5) * np.array(camera.size_px)
        center = np.append((pixel - camera.center_px) / camera.focal_px, 1.0) * depth
        rotation = rotation_from_vector(TILT_RAD * np.array([*turns, 0.0]))
        found.append((Pose(rotation, center - rotation @ middle), _words(u, v, depth, tilt, rig.core)))
    return found


def _words(u: float, v: float, depth_mm: float, tilt: str, core: str) -> str:
    row = "upper" if v < 0 else "lower" if v > 0 else ""
    column = "left" if u < 0 else "right" if u > 0 else "middle"
    place = f"{row} {column}".strip()
    tilted = f"tilted 35° with its {tilt}" if tilt else "square to the camera"
    return f"in the {place} of {core}'s view, {depth_mm:.0f} mm away, {tilted}"


def _information(
    rig: Rig, points_mm: Array, pose: Pose, corners_mm: Array, sigma_px: Array
) -> tuple[Array, tuple[str, ...]]:
    """(G, G) what a view of the board at ``pose`` says of the rig, its pose unknown; and who sees it."""
    cameras = len(rig.cameras)
    count = parameter_columns(cameras - 1, cameras)[-1] + 1
    shared, boards, seen_by = [], [], []
    on_board = corners_mm @ pose.rotation.T
    for i, name in enumerate(rig.cameras):
        by_point, by_rig, seen = camera_derivatives(rig, name, points_mm)
        if seen.sum() < MIN_CORNERS:
            continue
        columns = parameter_columns(i, cameras)
        block = np.zeros((int(seen.sum()), 2, count))
        block[:, :, columns] = by_rig[seen][:, :, : len(columns)] / sigma_px[i]
        shared.append(block.reshape(-1, count))
        turn = np.cross(on_board[seen][:, None, :], by_point[seen])
        boards.append((np.concatenate([turn, by_point[seen]], axis=-1) / sigma_px[i]).reshape(-1, 6))
        seen_by.append(name)
    if not seen_by:
        return np.zeros((count, count)), ()
    j, b = np.concatenate(shared), np.concatenate(boards)
    mixed = j.T @ b
    return j.T @ j - mixed @ np.linalg.solve(b.T @ b, mixed.T), tuple(seen_by)
