"""Recognition of the board in images that do not show the described one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.calibration.detection.board_mismatch import describe_contradiction, describe_shown_board
from beltscape.target.board import CharucoBoard, Chessboard, PlanarBoard
from tests.synthetic.boards import Print, board_poses, camera, view
from tests.thorough import THOROUGH, list_cases

EXPECTED_BOARD = CharucoBoard(squares=(5, 4), square_mm=30, marker_mm=20, dictionary="DICT_7X7_50")


def views(board: PlanarBoard, how: Print | None = None) -> list[np.ndarray]:
    return [view(camera("a"), pose, board, how) for pose in board_poses(board, 2 if THOROUGH else 1)]


@pytest.mark.parametrize(
    ("dictionary", "squares", "legacy", "inverted", "message"),
    [
        pytest.param(
            "DICT_4X4_50",
            (8, 6),
            False,
            False,
            "markers DICT_4X4_50 with ids up to 23 on a board of 8 columns",
            marks=pytest.mark.thorough,
        ),
        pytest.param(
            "DICT_5X5_100",
            (7, 5),
            False,
            False,
            "markers DICT_5X5_50 with ids up to 16 on a board of 7 columns",
            marks=pytest.mark.thorough,
        ),
        (
            "DICT_5X5_100",
            (6, 6),
            True,
            True,
            "markers DICT_5X5_50 with ids up to 17 on a board of 6 columns, inverted",
        ),
    ],
)
def test_another_charuco_board_is_recognised(dictionary, squares, legacy, inverted, message):
    board = CharucoBoard(squares=squares, square_mm=45, marker_mm=34, dictionary=dictionary)
    assert describe_shown_board(lambda: views(board, Print(legacy, inverted)), EXPECTED_BOARD) == message


@pytest.mark.thorough
def test_a_board_that_begins_with_another_marker_is_recognised():
    board = CharucoBoard(squares=(7, 6), square_mm=45, marker_mm=34, dictionary="DICT_5X5_100", first_id=46)
    shown = describe_shown_board(lambda: views(board), EXPECTED_BOARD)
    assert shown == "markers DICT_5X5_100 with ids 46 to 66 (first_id = 46) on a board of 7 columns"


@pytest.mark.parametrize("corners", list_cases([(5, 8), (6, 4)], {(5, 8)}))
def test_a_chessboard_is_recognised_longer_side_first(corners):
    board = Chessboard(corners=corners, square_mm=40)
    message = f"a chessboard of {max(corners)}×{min(corners)} inner corners"
    assert describe_shown_board(lambda: views(board), EXPECTED_BOARD) == message


@pytest.mark.parametrize("blur_px", list_cases([0.5, 2, 4, 8], {4}))
def test_texture_is_not_reported_as_a_board(blur_px):
    rng = np.random.default_rng(7)
    noise = [rng.integers(0, 255, (400, 480)).astype(np.uint8) for _ in range(2)]
    assert (
        describe_shown_board(lambda: [cv2.GaussianBlur(n, (0, 0), blur_px) for n in noise], EXPECTED_BOARD)
        is None
    )


def test_the_described_board_itself_is_not_reported():
    board = Chessboard(corners=(8, 5), square_mm=40)
    assert describe_shown_board(lambda: views(board), board) is None


STATED = CharucoBoard(squares=(8, 6), square_mm=45, marker_mm=34, dictionary="DICT_5X5_100")


@pytest.mark.parametrize(
    ("changes", "how", "keys"),
    [
        ({}, Print(), None),
        ({"legacy": True}, Print(legacy=True), None),
        ({"legacy": True}, Print(), "legacy = false (or no such key)"),
        ({"legacy": False}, Print(legacy=True), "legacy = true (or no such key)"),
        ({"squares": (6, 8)}, Print(), "squares = [8, 6]"),
        (
            {"squares": (6, 8), "legacy": True},
            Print(),
            "squares = [8, 6] and legacy = false (or no such key)",
        ),
        ({"inverted": True}, Print(), "inverted = false (or no such key)"),
    ],
)
def test_the_key_that_the_markers_contradict_is_named(changes, how, keys):
    board = STATED.model_copy(update=changes)
    named = describe_contradiction(
        views(STATED, how), board, legacy=bool(board.legacy), inverted=bool(board.inverted)
    )
    assert named == keys


@pytest.mark.parametrize("stated_mm", list_cases([20.0, 30.0, 38.0, 44.0], {20.0, 38.0}))
def test_a_wrong_marker_size_is_measured(stated_mm):
    board = STATED.model_copy(update={"marker_mm": stated_mm})
    named = describe_contradiction(views(STATED), board, legacy=False, inverted=False)
    assert named is not None
    key, _, value = named.partition(" = ")
    assert key == "marker_mm"
    assert float(value.partition(" ")[0]) == pytest.approx(STATED.marker_mm, rel=0.05)
