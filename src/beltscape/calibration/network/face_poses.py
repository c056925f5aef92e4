"""Poses of the boards of a rigid set relative to each other, from instants at which several of them are seen.

The cameras are calibrated with the boards as if they were single ones. Two boards at one instant then give their
relative pose; boards are joined along the pairs that were seen together most often, and all poses are refined with
the object's pose at every instant (variable projection: the object's pose follows from the boards').
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import Corners
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.target.board_set import BoardSet

Array = NDArray[np.float64]

MAX_STEPS = 20
"""Steps of the refinement at most; it converges within five."""
CONVERGED = 1e-9
"""The refinement has converged if no pose changes by more, in rad or shares of the distance."""
STUDENT_FREEDOM = 5.0
"""Degrees of freedom of the weights, as in the bundle adjustment."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One board in one image."""

    board: int
    """Number of the board in the set."""
    corners: Corners
    """Numbered within the set."""
    camera: Camera
    cam_from_core: Pose
    core_from_board: Pose


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The rays to one board's corners from one camera."""

    board: int
    ids: NDArray[np.int64]
    """(n,) numbered within the board."""
    rays: Array
    """(n, 2) x/z, y/z."""
    focal_px: float
    cam_from_core: Pose
    core_from_board: Pose


def estimate_face_poses(instants: Iterable[Sequence[Sighting]], board: BoardSet) -> BoardSet:
    """Return the set with all its boards placed, from the boards seen at one instant; those with a place keep it.

    ``core`` is any frame that the cameras of an instant share; a single camera is its own.

    Raises
    ------
    CalibrationError
        When a board is never seen together with the others.
    """
    views = [[_make_part(each, board) for each in instant] for instant in instants]
    views = [parts for parts in views if len({part.board for part in parts}) > 1]
    poses = _chain_poses(views, board)
    fixed = [k for k, face in enumerate(board.faces) if face.placement is not None] or [0]
    refined = _refine(views, poses, fixed, board)
    return board.place(
        {face.name: refined[k] for k, face in enumerate(board.faces) if face.placement is None}
    )


def _make_part(sighting: Sighting, board: BoardSet) -> _Part:
    rays = sighting.camera.undistort(sighting.corners.pixels)
    valid = np.isfinite(rays).all(axis=1)
    return _Part(
        sighting.board,
        sighting.corners.ids[valid] - board.offsets[sighting.board],
        rays[valid],
        float(sighting.camera.focal_px.mean()),
        sighting.cam_from_core,
        sighting.core_from_board,
    )


def _chain_poses(views: list[list[_Part]], board: BoardSet) -> list[Pose]:
    """Return object_from_board of every board, along the pairs of boards that most images show together."""
    pairs: dict[tuple[int, int], list[Pose]] = {}
    for view in views:
        for first, second in permutations(view, 2):
            if first.board != second.board:
                relative = first.core_from_board.inverse() @ second.core_from_board
                pairs.setdefault((first.board, second.board), []).append(relative)
    known = {k: f.placement.to_pose() for k, f in enumerate(board.faces) if f.placement is not None}
    known = known or {0: Pose.identity()}
    while len(known) < len(board.faces):
        reachable = [(len(poses), -a, -b) for (a, b), poses in pairs.items() if a in known and b not in known]
        if not reachable:
            missing = [face.name for k, face in enumerate(board.faces) if k not in known]
            raise CalibrationError(
                f"boards {', '.join(missing)}: no image shows them together with another board whose place is known, "
                "so that theirs cannot be estimated; turn the object so that two boards are visible at once, or give "
                "origin_mm, x_axis and y_axis in board.toml"
            )
        _, a, b = max(reachable)
        known[-b] = known[-a] @ _select_medoid(pairs[-a, -b])
    return [known[k] for k in range(len(board.faces))]


def _select_medoid(poses: list[Pose]) -> Pose:
    scale = max(float(np.median([np.linalg.norm(pose.translation_mm) for pose in poses])), 1.0)
    features = np.stack(
        [np.concatenate([pose.rotation.ravel() * scale, pose.translation_mm]) for pose in poses]
    )
    distances = np.linalg.norm(features[:, None] - features[None], axis=2)
    return poses[int(np.argmin(distances.sum(axis=1)))]


def _refine(views: list[list[_Part]], poses: list[Pose], fixed: list[int], board: BoardSet) -> list[Pose]:
    """Refine the boards' poses and the object's pose in every view by Gauss–Newton with Student weights."""
    corners = [
        np.column_stack([c, np.zeros(len(c))]) for c in (face.board.corners_mm() for face in board.faces)
    ]
    objects = [view[0].core_from_board @ poses[view[0].board].inverse() for view in views]
    free = [k for k in range(len(poses)) if k not in fixed]
    if not free:
        return poses
    for _ in range(MAX_STEPS):
        hessian, gradient = np.zeros((6 * len(poses), 6 * len(poses))), np.zeros(6 * len(poses))
        steps: list[tuple[Array, Array]] = []
        for view, core_from_object in zip(views, objects, strict=True):
            by_object, by_boards, errors = _differentiate(view, core_from_object, poses, corners)
            inner = np.linalg.inv(by_object.T @ by_object)
            coupling = by_boards.T @ by_object
            hessian += by_boards.T @ by_boards - coupling @ inner @ coupling.T
            gradient += by_boards.T @ errors - coupling @ inner @ (by_object.T @ errors)
            steps.append((inner @ (by_object.T @ errors), inner @ coupling.T))
        columns = np.concatenate([6 * k + np.arange(6) for k in free])
        step = np.zeros(6 * len(poses))
        step[columns] = -np.linalg.solve(hessian[np.ix_(columns, columns)], gradient[columns])
        objects = [
            _move(pose, -(alone + by @ step)) for pose, (alone, by) in zip(objects, steps, strict=True)
        ]
        poses = [_move(pose, step[6 * k : 6 * k + 6]) for k, pose in enumerate(poses)]
        if np.abs(step.reshape(-1, 6) / [1, 1, 1, 1e3, 1e3, 1e3]).max() < CONVERGED:
            break
    return poses


def _move(pose: Pose, step: Array) -> Pose:
    """Return a pose after a step in its own frame: turn (rad) and shift (mm)."""
    return pose @ Pose.of(step[:3], step[3:])


def _differentiate(
    view: list[_Part], core_from_object: Pose, poses: list[Pose], corners: list[Array]
) -> tuple[Array, Array, Array]:
    """Return weighted derivatives by the object's pose (2n, 6) and the boards' (2n, 6·boards), and errors (2n,)."""
    by_object: list[Array] = []
    by_boards: list[Array] = []
    errors: list[Array] = []
    for part in view:
        k, on_board = part.board, corners[part.board][part.ids]
        cam_from_object = part.cam_from_core @ core_from_object
        on_object = poses[k].apply(on_board)
        in_camera = cam_from_object.apply(on_object)
        x, y, z = in_camera.T
        zero = np.zeros_like(z)
        by_point = np.stack(
            [np.stack([1 / z, zero, -x / z**2], axis=1), np.stack([zero, 1 / z, -y / z**2], axis=1)], axis=1
        )
        by_point = by_point * part.focal_px
        in_object = by_point @ cam_from_object.rotation
        own = np.zeros((len(on_board), 2, 6 * len(poses)))
        own[:, :, 6 * k : 6 * k + 6] = _by_pose(in_object @ poses[k].rotation, on_board)
        by_object.append(_by_pose(in_object, on_object).reshape(-1, 6))
        by_boards.append(own.reshape(-1, 6 * len(poses)))
        errors.append((part.focal_px * (in_camera[:, :2] / z[:, None] - part.rays)).ravel())
    error = np.concatenate(errors)
    length = np.repeat((error.reshape(-1, 2) ** 2).sum(axis=1), 2)
    variance = max(float(np.median(length)) / 1.386, 1e-8)  # of a coordinate: the median of χ² with 2 degrees
    root = np.sqrt((STUDENT_FREEDOM + 2) / (STUDENT_FREEDOM + length / variance))
    return np.concatenate(by_object) * root[:, None], np.concatenate(by_boards) * root[:, None], error * root


def _by_pose(by_point: Array, points: Array) -> Array:
    """Return derivatives (n, 2, 6) by a step of `_move`, from those by the point (n, 2, 3) in the pose's frame."""
    x, y, z = points.T
    zero = np.zeros_like(x)
    turn = np.stack(
        [np.stack([zero, z, -y], axis=1), np.stack([-z, zero, x], axis=1), np.stack([y, -x, zero], axis=1)],
        axis=1,
    )  # turn × point
    return np.concatenate([by_point @ turn, by_point], axis=2)
