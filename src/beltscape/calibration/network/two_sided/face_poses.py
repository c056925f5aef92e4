"""Poses of the boards of a rigid set relative to each other, from instants at which several of them are seen.

The cameras are calibrated with the boards as if they were single ones. Two boards at one instant then give their
relative pose; boards are joined along the pairs that were seen together most often, and all poses are adjusted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.network.two_sided.face_adjustment import FacePoses, FaceRays, adjust_face_poses
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.target.board_set import BoardSet

Array = NDArray[np.float64]


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
    return board.place(
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
