"""Cameras that find a board in mirrored images only: they see it from behind, or they mirror.

One image does not tell the two apart. Two cameras do: the pose of one relative to the other is the same in every
frame only if the image is taken for what it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.intrinsics.zhang import calibrate_camera
from beltscape.calibration.solver.deterministic import single_thread
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.target.board import Board, corner_points_mm

MIN_RATIO = 2.0
"""Ratio of the scatter of relative poses above which the explanation with the smaller one is accepted. On photographs
of a two-sided board it is above 20."""

Side = Literal["behind", "mirrored", "undetermined"]


def list_back_only(detections: BoardDetections) -> tuple[str, ...]:
    """Return the cameras that have views, all of them from behind."""
    return tuple(
        name
        for name, views in detections.views.items()
        if views and all(corners.from_behind for corners in views.values())
    )


def classify_back_views(
    detections: BoardDetections, board: Board, known: Mapping[str, Camera] | None = None
) -> dict[str, Side]:
    """Classify the cameras of `list_back_only` by the scatter of their poses relative to the other cameras."""
    back = list_back_only(detections)
    front = [name for name in detections.cameras if detections.views[name] and name not in back]
    if not back or not front:
        return dict.fromkeys(back, "undetermined")
    with single_thread():
        references = [
            poses for name in front if (poses := _find_poses(name, detections, board, known)) is not None
        ]
        return {name: _classify(name, detections, board, references, known) for name in back}


def _classify(
    name: str,
    detections: BoardDetections,
    board: Board,
    references: list[Mapping[str, Pose]],
    known: Mapping[str, Camera] | None,
) -> Side:
    options: list[tuple[Side, BoardDetections]] = [
        ("behind", detections), ("mirrored", _flip_camera(detections, name)),
    ]  # fmt: skip
    scatter: dict[Side, float] = {}
    for side, flipped in options:
        poses = _find_poses(name, flipped, board, known)
        values = [_compute_scatter(poses, reference) for reference in references] if poses else []
        scatter[side] = min((value for value in values if np.isfinite(value)), default=np.inf)
    if not np.isfinite(scatter["behind"]) or not np.isfinite(scatter["mirrored"]):
        return "undetermined"
    if scatter["mirrored"] * MIN_RATIO < scatter["behind"]:
        return "mirrored"
    return "behind" if scatter["behind"] * MIN_RATIO < scatter["mirrored"] else "undetermined"


def _flip_camera(detections: BoardDetections, name: str) -> BoardDetections:
    """Return the detections with one camera's images mirrored."""
    width = detections.sizes_px[name][0]
    views = {frame: _flip(corners, width) for frame, corners in detections.views[name].items()}
    return replace(detections, views={**detections.views, name: views})


def _flip(corners: Corners, width: int) -> Corners:
    pixels = np.column_stack([width - 1 - corners.pixels[:, 0], corners.pixels[:, 1]])
    return replace(corners, pixels=pixels)


def _find_poses(
    name: str, detections: BoardDetections, board: Board, known: Mapping[str, Camera] | None
) -> Mapping[str, Pose] | None:
    """Return cam_from_board by frame from a camera's own views; None if they are too few."""
    try:
        return calibrate_camera(
            name, detections, corner_points_mm(board), known=(known or {}).get(name)
        ).cam_from_board
    except CalibrationError:
        return None


def _compute_scatter(poses: Mapping[str, Pose], reference: Mapping[str, Pose]) -> float:
    """Return the median angle between two frames' rotations from one camera to the other; NaN below three frames."""
    common = [frame for frame in poses if frame in reference]
    if len(common) < 3:
        return float("nan")
    turns = np.stack([poses[frame].rotation @ reference[frame].rotation.T for frame in common])
    cosine = (np.einsum("aij,bij->ab", turns, turns) - 1) / 2
    angles = np.arccos(cosine.clip(-1, 1))
    return float(np.median(angles[np.triu_indices(len(common), 1)]))
