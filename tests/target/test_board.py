"""Calibration boards: board.toml, and corners compared with OpenCV's."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.target.board import CharucoBoard, Chessboard, adjacent_corners, corner_points_mm, read_board

CHARUCO = """kind = "charuco"
squares = [5, 4]
square_mm = 30.0
marker_mm = 22.0
dictionary = "DICT_5X5_100"
"""
CHESSBOARD = 'kind = "chessboard"\ncorners = [9, 6]\nsquare_mm = 25\n'


def test_charuco_board_keeps_unset_flags_unset(tmp_path):
    (tmp_path / "board.toml").write_text(CHARUCO)
    board = read_board(tmp_path / "board.toml")
    assert isinstance(board, CharucoBoard)
    assert board == CharucoBoard(squares=(5, 4), square_mm=30, marker_mm=22, dictionary="DICT_5X5_100")
    assert (board.legacy, board.inverted) == (None, None)
    assert board.grid == (4, 3)
    assert board.describe() == "ChArUco 5×4, DICT_5X5_100, square 30 mm"


def test_chessboard_is_read(tmp_path):
    (tmp_path / "board.toml").write_text(CHESSBOARD)
    board = read_board(tmp_path / "board.toml")
    assert board == Chessboard(corners=(9, 6), square_mm=25)
    assert board.describe() == "chessboard 9×6 inner corners, square 25 mm"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", 'kind is missing; write kind = "charuco", "chessboard" or "aprilgrid"'),
        ('kind = "charco"', 'kind = \'charco\': must be "charuco", "chessboard" or "aprilgrid"'),
        ("kind = [1]", 'kind = [1]: must be "charuco", "chessboard" or "aprilgrid"'),
        (CHARUCO.replace("marker_mm", "markermm"), "unknown key markermm; did you mean marker_mm?"),
        (CHARUCO.replace("square_mm = 30.0\n", ""), "square_mm is missing"),
        (CHARUCO.replace("30.0", "-30"), "square_mm = -30: must be greater than 0"),
        (
            CHARUCO.replace("30.0", "0.03"),
            "square_mm = 0.03: cannot be the edge of a board's square in mm (0.6 to 1000); in metres? write 30",
        ),
        (CHARUCO.replace("30.0", '"30"'), "square_mm = '30': must be a number, without quotation marks"),
        (CHARUCO.replace("30.0", "true"), "square_mm = true: must be a number"),
        (CHARUCO + "inverted = 1\n", "inverted = 1: must be true or false"),
        (CHARUCO.replace("30.0", "inf"), "square_mm = inf: must be a finite number"),
        (CHARUCO.replace("22.0", "30"), "marker_mm = 30 must be smaller than square_mm = 30"),
        (CHARUCO.replace("[5, 4]", "[5]"), "squares[1] is missing"),
        (CHARUCO.replace("[5, 4]", "[5, 1]"), "squares[1] = 1: must be greater than or equal to 2"),
        (
            CHARUCO.replace("[5, 4]", "[15, 14]"),
            "squares = [15, 14] need 105 markers, DICT_5X5_100 has 100; correct squares or dictionary",
        ),
        (
            CHARUCO.replace("5X5_100", "5X5_101"),
            "dictionary = 'DICT_5X5_101': no ArUco dictionary is called DICT_5X5_101; one is DICT_5X5_100",
        ),
        (CHARUCO + "inverted = 7\n", "inverted = 7: must be true or false"),
        (
            CHESSBOARD + "dictionary = 1\n",
            "unknown key dictionary; known: kind, corners, square_mm, square_sigma_mm",
        ),
        (CHESSBOARD.replace("corners = [9, 6]\n", ""), "corners is missing"),
    ],
)
def test_invalid_file_is_refused_naming_the_key(tmp_path, text, message):
    path = tmp_path / "board.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_board(path)
    assert str(error.value) == f"{path}: {message}"


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("squares", [(5, 4), (4, 5), (7, 3)])
def test_corner_points_equal_those_of_opencv(squares, legacy):
    board = CharucoBoard(squares=squares, square_mm=30, marker_mm=22, dictionary="DICT_5X5_100")
    theirs = board.to_opencv(legacy=legacy)
    np.testing.assert_allclose(corner_points_mm(board), theirs.getChessboardCorners(), atol=1e-4)
    assert theirs.getLegacyPattern() is legacy


def test_board_may_use_every_marker_of_its_dictionary():
    board = CharucoBoard(squares=(11, 9), square_mm=30, marker_mm=22, dictionary="DICT_5X5_50")
    assert (
        board.to_opencv(legacy=False).getIds().size
        == cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50).bytesList.shape[0] - 1
    )


@pytest.mark.parametrize("grid", [(9, 6), (3, 4)])
def test_adjacent_corners_are_complete_and_one_square_apart(grid):
    board = Chessboard(corners=grid, square_mm=12.5)
    points = corner_points_mm(board)
    edges = adjacent_corners(board)
    np.testing.assert_allclose(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1), 12.5)
    columns, rows = grid
    assert len({tuple(sorted(edge)) for edge in edges.tolist()}) == columns * (rows - 1) + rows * (
        columns - 1
    )
