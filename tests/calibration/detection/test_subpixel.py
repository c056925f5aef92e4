"""Subpixel refinement of corners under blur, bleeding ink, gamma and occlusion."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.detection.subpixel import refine_corners
from beltscape.target.board import CharucoBoard, Chessboard, corner_points_mm
from tests.synthetic.boards import Print, camera, facing, view

CHARUCO = CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")
CHESSBOARD = Chessboard(corners=(8, 5), square_mm=40)
LENS = camera("a")


def errors(image, board, at, seed=0, gap=None):
    """Return errors (n, 2) of corners that start half a pixel off, and which of them remain."""
    true = LENS.project(at.apply(corner_points_mm(board)))
    off = np.random.default_rng(seed).uniform(-0.5, 0.5, true.shape)
    if gap is None:
        gap = (1 - board.marker_mm / board.square_mm) / 2 if isinstance(board, CharucoBoard) else 1.0
    squares = corner_points_mm(board)[:, :2] / board.square_mm
    found = refine_corners(image.astype(np.float32), Corners(np.arange(len(true)), true + off), squares, gap)
    return found.pixels - true[found.ids], found.ids


@pytest.mark.parametrize("board", [CHARUCO, CHESSBOARD], ids=["charuco", "chessboard"])
@pytest.mark.parametrize("blur_px", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("roll", [0.1, 0.8])
def test_corners_are_refined_to_a_hundredth_of_a_pixel_at_any_focus(board, blur_px, roll):
    at = facing(board, roll, 0.4)
    error, ids = errors(view(LENS, at, board, Print(blur_px=blur_px)), board, at)
    assert len(ids) == len(corner_points_mm(board))
    assert np.sqrt((error**2).mean()) < 0.02
    assert np.abs(error.mean(axis=0)).max() < 0.01


def test_bleeding_ink_does_not_displace_corners():
    at = facing(CHESSBOARD, 0.1, 0.4)
    image = view(LENS, at, CHESSBOARD, Print(noise=0.0))
    bled = cv2.GaussianBlur(cv2.erode(image, np.ones((3, 3), np.uint8)), (0, 0), 0.7)  # dark grows by a pixel
    error, ids = errors(bled, CHESSBOARD, at)
    assert len(ids) > 30
    assert np.abs(error.mean(axis=0)).max() < 0.03
    assert np.sqrt((error**2).mean()) < 0.08


def test_gamma_does_not_displace_corners():
    at = facing(CHARUCO, 0.1, 0.4)
    image = 255 * (view(LENS, at, CHARUCO, Print(noise=0.3)) / 255.0) ** 0.45
    error, _ = errors(image, CHARUCO, at)
    assert np.abs(error.mean(axis=0)).max() < 0.01
    assert np.sqrt((error**2).mean()) < 0.03


def test_a_covered_corner_is_dropped():
    at = facing(CHARUCO, 0.1, 0.4)
    image = view(LENS, at, CHARUCO)
    u, v = np.rint(LENS.project(at.apply(corner_points_mm(CHARUCO)))[17]).astype(int)
    image[v - 12 : v + 4, u - 12 : u + 9] = 200
    error, ids = errors(image, CHARUCO, at)
    assert 17 not in ids
    assert len(ids) == 34
    assert np.sqrt((error**2).mean()) < 0.02


def test_an_empty_image_gives_no_corners():
    _, ids = errors(np.full((400, 480), 128.0), CHARUCO, facing(CHARUCO, 0.1, 0.4))
    assert len(ids) == 0
