"""Boards printed on both sides: the print on the back is a face of its own, whose place follows from the views.

The two prints are never quite opposite: on photographs of a board of four by five squares of 54 mm, the back was 7 mm
beside the front and 3 mm behind it. Taken for one print, the corners miss each other by that in every frame.

Cameras that find a board in mirrored images only see it from behind, or they mirror. One image does not tell the
two apart. Two cameras do: the pose of one relative to the other is the same in every frame only if the image is
taken for what it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.intrinsics.zhang import MonocularCalibration, calibrate_camera
from beltscape.calibration.network.face_poses import FacePoses, Sighting, adjust_face_poses, list_face_views
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import Board, Chessboard, PlanarBoard, corner_points_mm
from beltscape.target.board_set import BoardFace, BoardSet

NAMES = ("front", "back")
TURN_SIGMA = 0.05
"""Standard deviation of the back's turn against the front, rad: a sheet that is glued on by eye."""
SHIFT_SIGMA_SHARE = 0.05
"""Standard deviation of the back's shift, over the board's diagonal: 15 mm of a board of A4's size."""
THICKNESS_SIGMA_MM = 0.2
"""Standard deviation of a given thickness: glue, and paper that does not lie flat."""
NOISE_PX = 0.3
"""Noise of a corner for which these standard deviations are weighed against the views."""


def has_two_sides(detections: BoardDetections) -> bool:
    """Return whether some views show a board's front and others its back."""
    sides = {corners.from_behind for views in detections.views.values() for corners in views.values()}
    return len(sides) == 2


def number_sides(detections: BoardDetections, board: PlanarBoard) -> tuple[BoardDetections, BoardSet]:
    """Return the detections with the corners of the back numbered after those of the front, and both as a set."""
    count = board.grid[0] * board.grid[1]
    views = {
        name: {frame: _number(corners, count) for frame, corners in own.items()}
        for name, own in detections.views.items()
    }
    faces = tuple(BoardFace(name=name, board=board, from_behind=name == "back") for name in NAMES)
    return replace(detections, views=views), BoardSet(faces=faces)


def place_back(
    detections: BoardDetections, sides: BoardSet, rig: Rig, monocular: Mapping[str, MonocularCalibration]
) -> BoardSet:
    """Return the set with the back placed, from instants at which cameras see different sides.

    ``rig`` took both sides for one print; the cameras' poses are adjusted with the back's place, since a camera
    that only sees the back has taken over the error.

    Raises
    ------
    CalibrationError
        When no instant shows both sides, or the views do not determine the place.
    """
    instants = [_list_sightings(frame, detections, rig, monocular) for frame in detections.frames]
    views = list_face_views(instants, sides)
    board = sides.faces[0].board
    thickness = _get_thickness_mm(board)
    back = Pose(np.eye(3), np.array([0.0, 0.0, thickness or 0.0]))
    sigmas = compute_place_sigma(sides)
    start = FacePoses((Pose.identity(), back), dict(rig.cam_from_core))
    try:
        found = adjust_face_poses(views, start, sides, [1], rig.auxiliaries, (NOISE_PX / sigmas) ** 2)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            "the views do not tell how the prints on the board's two sides lie; show the board at other tilts"
        ) from error
    return sides.place_by_views(dict(zip(NAMES, found.boards, strict=True)))


def compute_place_sigma(boards: BoardSet) -> Array:
    """Return one standard deviation (6,) of a board's turns, rad, and shifts, mm, against the first one of a set."""
    board = boards.faces[0].board
    shift = SHIFT_SIGMA_SHARE * float(np.linalg.norm(np.ptp(boards.corners_mm(), axis=0)))
    is_known = boards.is_two_sided and _get_thickness_mm(board) is not None
    return np.array([*[TURN_SIGMA] * 3, shift, shift, THICKNESS_SIGMA_MM if is_known else shift])


def _get_thickness_mm(board: PlanarBoard) -> float | None:
    return None if isinstance(board, Chessboard) else board.thickness_mm


def describe_back(board: BoardSet) -> str:
    """Return a line with the place of the print on the back."""
    back = board.faces[-1].placement
    shift = np.zeros(3) if back is None else np.array(back.origin_mm)
    return (
        f"the board is printed on both sides: the print on the back lies {np.hypot(*shift[:2]):.1f} mm beside that "
        f"on the front and {abs(shift[2]):.1f} mm {'behind' if shift[2] >= 0 else 'before'} it"
    )


def _number(corners: Corners, count: int) -> Corners:
    return replace(corners, ids=corners.ids + count) if corners.from_behind else corners


def _list_sightings(
    frame: str, detections: BoardDetections, rig: Rig, monocular: Mapping[str, MonocularCalibration]
) -> list[Sighting]:
    found: list[Sighting] = []
    for name, camera in rig.cameras.items():
        corners, pose = detections.views[name].get(frame), monocular[name].cam_from_board.get(frame)
        if corners is not None and pose is not None:
            cam_from_core = rig.cam_from_core[name]
            core_from_board = cam_from_core.inverse() @ pose
            found.append(Sighting(int(corners.from_behind), corners, camera, cam_from_core, core_from_board))
    return found


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
