"""Advice on views that determine no rig: it names what they lack."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.remedy import (
    BoardSize,
    advise_views,
    describe_undetermined,
    measure_boards,
)
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.hierarchy import HierarchyResult, solve_hierarchy
from beltscape.core.progress import Silent
from beltscape.target.board import Chessboard
from tests.synthetic.boards import row_of_cameras
from tests.synthetic.camera_arrays import BOARD, boards_before, detect, like_cameras
from tests.synthetic.detections import make_detections


def solve_shared(count: int) -> HierarchyResult:
    """Return the hierarchy of two cameras that see nine boards each, and some of them together."""
    rig = like_cameras(2, 1)
    seen = detect(rig, boards_before(rig, 18 - count, 0.3, 1), 0.05, 1)
    frames = list(seen.views["c00"])
    views = {
        "c00": {frame: seen.views["c00"][frame] for frame in frames[:9]},
        "c01": {frame: seen.views["c01"][frame] for frame in frames[9 - count :]},
    }
    return solve_hierarchy(replace(seen, views=views), BOARD, None, Silent())


def test_few_shared_frames_are_named():
    line = describe_undetermined(solve_shared(3))
    assert line.startswith(
        "the views do not determine the rig: cameras c00 and c01 share only 3 usable views of the board "
        "(06, 07, 08); show it to both at the same instant: photograph the board in 10 positions or more"
    )
    assert "leading minor" not in line
    assert "share only" not in describe_undetermined(solve_shared(6))


def test_a_board_that_is_small_in_the_images_is_named_instead_of_its_positions():
    """Ten positions of a board 90 px wide: more of them are not the remedy."""
    small = Chessboard(corners=(8, 5), square_mm=17)
    rig = row_of_cameras(["a", "b"])
    poses = boards_before(like_cameras(2, 3), 10, 0.4, 3)
    middle = np.array([9, 6, 0]) / 2 * small.square_mm
    poses = [replace(p, translation_mm=np.array([0, 0, 700.0]) - p.rotation @ middle) for p in poses]
    hierarchy = solve_hierarchy(make_detections(rig, small, poses, 0.05), small, None, Silent())
    line = advise_views(adjust_bundle(hierarchy, small))
    assert line.startswith("10 positions of the board, tilted by ")
    assert " do not suffice, for the board is only 9" in line
    assert "px wide in images 480 px wide: bring it nearer, or take a larger one" in line
    assert "10 positions or more" not in line
    assert "the board is only 9" in describe_undetermined(hierarchy)


@pytest.mark.parametrize(("board_px", "is_small"), [(90.0, True), (179.0, True), (181.0, False)])
def test_a_quarter_of_the_image_is_the_limit(board_px, is_small):
    assert BoardSize(board_px, 720.0).is_small is is_small
    corners = np.array([[0.0, 0.0], [board_px, 20.0]])
    assert measure_boards([(corners, (720, 540))]) == BoardSize(board_px, 720.0)


def test_many_positions_of_a_large_board_need_other_tilts():
    rig = like_cameras(2, 2)
    hierarchy = solve_hierarchy(
        detect(rig, boards_before(rig, 10, 0.03, 2), 0.05, 2), BOARD, None, Silent(), known=rig.cameras
    )
    line = advise_views(adjust_bundle(hierarchy, BOARD))
    assert line.endswith(
        "do not suffice; photograph the board tilted about 30° to every side, near and far and in all parts of "
        "every image, beside the present positions"
    )
