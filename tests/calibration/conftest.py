"""Rigs, boards and board poses for tests without images."""

from __future__ import annotations

import pytest

from beltscape.core.geometry.rig import Rig
from beltscape.target.board import CharucoBoard
from tests.synthetic.boards import board_poses, row_of_cameras


@pytest.fixture(scope="session")
def rig() -> Rig:
    return row_of_cameras(["a", "b", "c", "d"])


@pytest.fixture(scope="session")
def board() -> CharucoBoard:
    return CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")


@pytest.fixture(scope="session")
def poses(board):
    return board_poses(board, 12)
