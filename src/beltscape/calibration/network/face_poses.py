"""Poses of the boards of a rigid set relative to each other, from instants at which several of them are seen.

The cameras are calibrated with the boards as if they were single ones. Two boards at one instant then give their
relative pose; boards are joined along the pairs that were seen together most often, and all poses are adjusted.

The adjustment takes the corners seen at common instants. The object's pose at every instant follows from the other
unknowns and is eliminated (variable projection).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import Corners
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.target.board_set import BoardSet

MAX_STEPS = 20
"""Steps of the adjustment at most; from poses of single views it converges within five, of a camera behind a board
within ten."""
CONVERGED = 1e-9
"""The adjustment has converged if no pose changes by more, in rad or shares of the distance."""
STUDENT_FREEDOM = 5.0
"""Degrees of freedom of the weights, as in the bundle adjustment."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceRays:
    """The rays to one board's corners from one camera at one instant."""

    board: int
    """Number of the board in the set."""
    ids: NDArray[np.int64]
    """(n,) numbered within the board."""
    rays: Array
    """(n, 2) x/z, y/z."""
    focal_px: float
    camera: str
    core_from_board: Pose
    """Estimate from this camera's view, or from all."""


@dataclass(frozen=True, slots=True, eq=False)
class FacePoses:
    """Poses of the boards of a set on the object, and of the cameras that see them."""

    boards: tuple[Pose, ...]
    """object_from_board of each board."""
    cameras: Mapping[str, Pose]
    """cam_from_core by name."""


def adjust_face_poses(
    views: Sequence[Sequence[FaceRays]],
    start: FacePoses,
    board: BoardSet,
    free_boards: Sequence[int],
    free_cameras: Sequence[str] = (),
    information: Array | None = None,
) -> FacePoses:
    """Adjust the poses of some boards and cameras by Gauss–Newton with Student weights.

    ``information`` (6,) is the inverse variance of each free board's turn (rad) and shift (mm) from its start.

    Raises
    ------
    numpy.linalg.LinAlgError
        When the views do not determine the poses.
    """
    corners = [
        np.column_stack([c, np.zeros(len(c))]) for c in (face.board.corners_mm() for face in board.faces)
    ]
    objects = [view[0].core_from_board @ start.boards[view[0].board].inverse() for view in views]
    names = list(start.cameras)
    blocks = [*free_boards, *(len(start.boards) + names.index(name) for name in free_cameras)]
    if not blocks:
        return start
    columns = np.concatenate([6 * k + np.arange(6) for k in blocks])
    poses = start
    for _ in range(MAX_STEPS):
        hessian, gradient, steps = _form_normal_equations(views, objects, poses, corners)
        if information is not None:
            _add_prior(hessian, gradient, information, start, poses, free_boards)
        step = np.zeros(len(gradient))
        step[columns] = -np.linalg.solve(hessian[np.ix_(columns, columns)], gradient[columns])
        objects = [
            _move(pose, -(alone + by @ step)) for pose, (alone, by) in zip(objects, steps, strict=True)
        ]
        moved = step.reshape(-1, 6)
        count = len(poses.boards)
        poses = FacePoses(
            tuple(_move(pose, own) for pose, own in zip(poses.boards, moved[:count], strict=True)),
            {name: _move(poses.cameras[name], own) for name, own in zip(names, moved[count:], strict=True)},
        )
        if np.abs(moved / [1, 1, 1, 1e3, 1e3, 1e3]).max() < CONVERGED:
            break
    return poses


def _form_normal_equations(
    views: Sequence[Sequence[FaceRays]], objects: Sequence[Pose], poses: FacePoses, corners: list[Array]
) -> tuple[Array, Array, list[tuple[Array, Array]]]:
    """Return Hessian, gradient by the boards and cameras, and how each object's step follows from theirs."""
    width = 6 * (len(poses.boards) + len(poses.cameras))
    hessian, gradient = np.zeros((width, width)), np.zeros(width)
    steps: list[tuple[Array, Array]] = []
    for view, core_from_object in zip(views, objects, strict=True):
        by_object, by_others, errors = _differentiate(view, core_from_object, poses, corners)
        inner = np.linalg.inv(by_object.T @ by_object)
        coupling = by_others.T @ by_object
        hessian += by_others.T @ by_others - coupling @ inner @ coupling.T
        gradient += by_others.T @ errors - coupling @ inner @ (by_object.T @ errors)
        steps.append((inner @ (by_object.T @ errors), inner @ coupling.T))
    return hessian, gradient, steps


def _add_prior(
    hessian: Array,
    gradient: Array,
    information: Array,
    start: FacePoses,
    poses: FacePoses,
    boards: Sequence[int],
) -> None:
    """Add the prior of boards about their start."""
    for k in boards:
        own = slice(6 * k, 6 * k + 6)
        change = start.boards[k].inverse() @ poses.boards[k]
        skew = (change.rotation - change.rotation.T) / 2
        turn = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
        hessian[own, own] += np.diag(information)
        gradient[own] += information * np.concatenate([turn, change.translation_mm])


def _move(pose: Pose, step: Array) -> Pose:
    """Return a pose after a step in its own frame: turn (rad) and shift (mm)."""
    return pose @ Pose.of(step[:3], step[3:])


def _differentiate(
    view: Sequence[FaceRays], core_from_object: Pose, poses: FacePoses, corners: list[Array]
) -> tuple[Array, Array, Array]:
    """Return weighted derivatives by the object's pose (2n, 6) and all others (2n, 6·others), and errors (2n,)."""
    by_object: list[Array] = []
    by_others: list[Array] = []
    errors: list[Array] = []
    names = list(poses.cameras)
    for part in view:
        k, on_board = part.board, corners[part.board][part.ids]
        camera = len(poses.boards) + names.index(part.camera)
        cam_from_core = poses.cameras[part.camera]
        on_object = poses.boards[k].apply(on_board)
        in_core = core_from_object.apply(on_object)
        in_camera = cam_from_core.apply(in_core)
        in_axes_of_core = _differentiate_rays(in_camera, part.focal_px) @ cam_from_core.rotation
        in_object = in_axes_of_core @ core_from_object.rotation
        own = np.zeros((len(on_board), 2, 6 * (len(poses.boards) + len(names))))
        own[:, :, 6 * k : 6 * k + 6] = _by_pose(in_object @ poses.boards[k].rotation, on_board)
        own[:, :, 6 * camera : 6 * camera + 6] = _by_pose(in_axes_of_core, in_core)
        by_object.append(_by_pose(in_object, on_object).reshape(-1, 6))
        by_others.append(own.reshape(2 * len(on_board), -1))
        errors.append((part.focal_px * (in_camera[:, :2] / in_camera[:, 2:] - part.rays)).ravel())
    error = np.concatenate(errors)
    length = np.repeat((error.reshape(-1, 2) ** 2).sum(axis=1), 2)
    variance = max(float(np.median(length)) / 1.386, 1e-8)  # of a coordinate: the median of χ² with 2 degrees
    root = np.sqrt((STUDENT_FREEDOM + 2) / (STUDENT_FREEDOM + length / variance))
    return np.concatenate(by_object) * root[:, None], np.concatenate(by_others) * root[:, None], error * root


def _differentiate_rays(in_camera: Array, focal_px: float) -> Array:
    """Return derivatives (n, 2, 3) of the rays, scaled by the focal length, by points in the camera's frame."""
    x, y, z = in_camera.T
    zero = np.zeros_like(z)
    return focal_px * np.stack(
        [np.stack([1 / z, zero, -x / z**2], axis=1), np.stack([zero, 1 / z, -y / z**2], axis=1)], axis=1
    )


def _by_pose(by_point: Array, points: Array) -> Array:
    """Return derivatives (n, 2, 6) by a step of `_move`, from those by the point (n, 2, 3) in the pose's frame."""
    x, y, z = points.T
    zero = np.zeros_like(x)
    turn = np.stack(
        [np.stack([zero, z, -y], axis=1), np.stack([-z, zero, x], axis=1), np.stack([y, -x, zero], axis=1)],
        axis=1,
    )  # turn × point
    return np.concatenate([by_point @ turn, by_point], axis=2)


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


def estimate_face_poses(instants: Sequence[Sequence[Sighting]], board: BoardSet) -> BoardSet:
    """Return the set with all its boards placed, from the boards seen at one instant; those with a place keep it.

    ``core`` is any frame that the cameras of an instant share; a single camera is its own.

    Raises
    ------
    CalibrationError
        When a board is never seen together with the others.
    """
    views = list_face_views(instants, board)
    cameras = {each.camera.name: each.cam_from_core for instant in instants for each in instant}
    start = FacePoses(tuple(_chain_poses(views, board)), cameras)
    fixed = [k for k, face in enumerate(board.faces) if face.placement is not None] or [0]
    refined = adjust_face_poses(views, start, board, [k for k in range(len(board.faces)) if k not in fixed])
    return board.place_by_views(
        {face.name: refined.boards[k] for k, face in enumerate(board.faces) if face.placement is None}
    )


def list_face_views(instants: Iterable[Sequence[Sighting]], board: BoardSet) -> list[list[FaceRays]]:
    """Return the rays of the instants at which at least two boards are seen."""
    views = [[_make_rays(each, board) for each in instant] for instant in instants]
    return [parts for parts in views if len({part.board for part in parts}) > 1]


def _make_rays(sighting: Sighting, board: BoardSet) -> FaceRays:
    rays = sighting.camera.undistort(sighting.corners.pixels)
    valid = np.isfinite(rays).all(axis=1)
    return FaceRays(
        sighting.board,
        sighting.corners.ids[valid] - board.offsets[sighting.board],
        rays[valid],
        float(sighting.camera.focal_px.mean()),
        sighting.camera.name,
        sighting.core_from_board,
    )


def _chain_poses(views: list[list[FaceRays]], board: BoardSet) -> list[Pose]:
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
