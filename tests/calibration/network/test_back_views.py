"""Cameras that find a board in mirrored images only: seen from behind, or mirrored by the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.network.two_sides import classify_back_views, list_back_only
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import CharucoBoard
from tests.synthetic.boards import board_poses, row_of_cameras
from tests.synthetic.detections import make_detections

BOARD = CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")
NOISE_PX = 0.1


def mark_from_behind(detections: BoardDetections, name: str) -> BoardDetections:
    views = {frame: replace(corners, from_behind=True) for frame, corners in detections.views[name].items()}
    return replace(detections, views={**detections.views, name: views})


@pytest.fixture(scope="module")
def behind():
    """Two cameras in front of the board and one on its other side, 1.4 m from the first."""
    front = row_of_cameras(["a", "b"])
    turn = Pose.of([0.0, np.pi, 0.0], np.zeros(3)).rotation
    poses = {**front.cam_from_core, "c": Pose(turn, -turn @ np.array([0.0, 0.0, 1400.0]))}
    rig = Rig("a", {**front.cameras, "c": replace(front.cameras["b"], name="c")}, poses)
    return mark_from_behind(make_detections(rig, BOARD, board_poses(BOARD, 8), NOISE_PX), "c")


def test_a_camera_behind_the_board_is_recognised(behind):
    assert list_back_only(behind) == ("c",)
    assert classify_back_views(behind, BOARD) == {"c": "behind"}


def test_a_mirroring_camera_is_recognised():
    """The detector mirrors such images once more and mirrors the corners back, as of a board from behind."""
    rig = row_of_cameras(["a", "b", "c"])
    seen = make_detections(rig, BOARD, board_poses(BOARD, 8), NOISE_PX)
    width = rig.cameras["c"].size_px[0]
    views = {
        frame: replace(corners, pixels=corners.pixels * [-1, 1] + [width - 1, 0])
        for frame, corners in seen.views["c"].items()
    }
    mirrored = mark_from_behind(replace(seen, views={**seen.views, "c": views}), "c")
    assert classify_back_views(mirrored, BOARD) == {"c": "mirrored"}


def test_two_common_frames_do_not_tell(behind):
    shared = behind.restrict(behind.cameras, behind.frames[:5])
    alone = {frame: corners for frame, corners in shared.views["c"].items() if frame in behind.frames[:2]}
    assert classify_back_views(replace(shared, views={**shared.views, "c": alone}), BOARD) == {
        "c": "undetermined"
    }


def test_without_a_camera_in_front_nothing_is_decided(behind):
    only = behind.restrict(("c",), behind.frames)
    assert classify_back_views(only, BOARD) == {"c": "undetermined"}
