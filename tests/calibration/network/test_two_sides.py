"""Boards printed on both sides, whose prints are not opposite: the back is placed, and the rig is not bent by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import HierarchyResult, solve_hierarchy
from beltscape.calibration.network.two_sides import describe_back, has_two_sides
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.pipeline.calibrating.board_sets import resolve_board_set, resolve_checked_set
from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics
from beltscape.target.board import BoardSet, CharucoBoard, corner_points_mm
from tests.synthetic.boards import board_poses, row_of_cameras
from tests.synthetic.detections import make_detections

BOARD = CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")
BACK = Pose.of([0.004, -0.003, 0.02], [5.0, -3.0, 4.0])
NOISE_PX = 0.1


@pytest.fixture(scope="module")
def rig():
    """Two cameras in front of the board, and one 1.4 m from them behind it."""
    front = row_of_cameras(["a", "b"])
    turn = Pose.of([0.0, np.pi, 0.0], np.zeros(3)).rotation
    poses = {**front.cam_from_core, "c": Pose(turn, -turn @ np.array([0.0, 0.0, 1400.0]))}
    return Rig("a", {**front.cameras, "c": replace(front.cameras["b"], name="c")}, poses)


@pytest.fixture(scope="module")
def detections(rig):
    poses = board_poses(BOARD, 14)
    front = make_detections(rig, BOARD, poses, NOISE_PX)
    back = make_detections(rig, BOARD, [pose @ BACK for pose in poses], NOISE_PX)
    behind = {frame: replace(corners, from_behind=True) for frame, corners in back.views["c"].items()}
    return replace(front, views={**front.views, "c": behind})


def solve(detections: BoardDetections, board: CharucoBoard) -> tuple[HierarchyResult, BoardSet]:
    own, sides, start = resolve_board_set(detections, board, KnownIntrinsics({}))
    assert isinstance(sides, BoardSet)
    return solve_hierarchy(own, sides, "a", Silent(), known=start.cameras, priors=start.priors), sides


def test_the_back_is_placed_and_all_cameras_stay_in_their_places(rig, detections):
    assert has_two_sides(detections)
    assert not has_two_sides(detections.restrict(("a", "b"), detections.frames))
    hierarchy, sides = solve(detections, BOARD)
    apart = corner_points_mm(sides)[35:] - BACK.apply(corner_points_mm(BOARD))
    assert np.sqrt((apart**2).sum(axis=1).mean()) < 0.3
    assert describe_back(sides).startswith(
        "the board is printed on both sides: the print on the back lies 5."
    )
    pair = next(pair for pair in hierarchy.network.pairs if {pair.first, pair.second} == {"a", "c"})
    assert pair.rms_px < 2 * NOISE_PX
    adjusted = adjust_bundle(hierarchy, sides)
    # taken for one print: 3.8 and 9 mm; with the true place of the back 0.1 and 3.9 mm (σ 2.9 mm in x)
    for name, limit_mm in (("b", 0.5), ("c", 5.0)):
        off = adjusted.rig.cam_from_core[name].center_mm - rig.cam_from_core[name].center_mm
        assert np.linalg.norm(off) < limit_mm
    former = replace(adjusted.rig, quality={"board": sides.model_dump()})
    checked, board = resolve_checked_set(detections, BOARD, former)
    assert board == sides
    assert checked.views["c"]["00"].ids.min() >= 35


def test_a_given_thickness_is_kept(detections):
    _, sides = solve(detections, BOARD.model_copy(update={"thickness_mm": 4.0}))
    placement = sides.faces[1].placement
    assert placement is not None
    assert placement.origin_mm[2] == pytest.approx(4.0, abs=0.4)
