"""Boards printed on both sides: the print on the back is a face of its own, whose place follows from the views.

The two prints are never quite opposite: on photographs of a board of four by five squares of 54 mm, the back was 7 mm
beside the front and 3 mm behind it. Taken for one print, the corners miss each other by that in every frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.calibration.network.two_sided.face_adjustment import FacePoses, adjust_face_poses
from beltscape.calibration.network.two_sided.face_poses import Sighting, list_face_views
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import Chessboard, PlanarBoard
from beltscape.target.board_set import BoardSet, Face

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
    faces = tuple(Face(name=name, board=board, from_behind=name == "back") for name in NAMES)
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
    thickness = None if isinstance(board, Chessboard) else board.thickness_mm
    back = Pose(np.eye(3), np.array([0.0, 0.0, thickness or 0.0]))
    shift = SHIFT_SIGMA_SHARE * float(np.linalg.norm(np.ptp(board.corners_mm(), axis=0)))
    sigmas = np.array([*[TURN_SIGMA] * 3, shift, shift, shift if thickness is None else THICKNESS_SIGMA_MM])
    start = FacePoses((Pose.identity(), back), dict(rig.cam_from_core))
    try:
        found = adjust_face_poses(views, start, sides, [1], rig.auxiliaries, (NOISE_PX / sigmas) ** 2)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            "the views do not tell how the prints on the board's two sides lie; show the board at other tilts"
        ) from error
    return sides.place(dict(zip(NAMES, found.boards, strict=True)))


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
