"""Quarter turns of a board about its centre: its rotational symmetries and the renumbering of its corners."""

from __future__ import annotations

import numpy as np

from beltscape.calibration.detection.corners import Corners
from beltscape.core.geometry.pose import Pose
from beltscape.target.board import Board, BoardSet, Chessboard, corner_points_mm


def list_quarter_turns(board: Board) -> tuple[int, ...]:
    """Return the quarter turns under which a board looks the same, 0 first."""
    if not isinstance(board, Chessboard) or sum(board.grid) % 2:
        return (0,)
    columns, rows = board.grid
    return (0, 1, 2, 3) if columns == rows else (0, 2)


def make_board_turn(board: Board, turn: int) -> Pose:
    """Return ``board_from_turned``, the pose of a board after quarter turns about its centre."""
    center = corner_points_mm(board).mean(axis=0)
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[turn % 4]
    rotation = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], np.float64)
    return Pose(rotation, center - rotation @ center)


def turn_corners(corners: Corners, board: Board, turn: int) -> Corners:
    """Renumber the corners of an image for a board after quarter turns; ids ascend again."""
    if isinstance(board, BoardSet):
        return corners  # `list_quarter_turns` lists none
    columns, rows = board.grid
    former = np.rot90(np.arange(columns * rows).reshape(rows, columns), turn).ravel()
    ids = np.argsort(former)[corners.ids]
    order = np.argsort(ids)
    return Corners(ids[order].astype(np.int64), corners.pixels[order])
