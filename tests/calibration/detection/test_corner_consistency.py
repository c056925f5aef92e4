"""Corners that the board's others contradict: left out one by one, while the view is kept."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.calibration.detection.corner_consistency import find_consistent, place_corners
from beltscape.calibration.detection.detector import PrintVariant, make_detector
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.target.board import AprilGrid, BoardSet, CharucoBoard, corner_points_mm
from tests.synthetic.boards import Print, view
from tests.thorough import count_examples, list_cases

SIZE_PX = 800, 660
CENTER = np.array([404.0, 327.0])
BROWN = Camera("brown", SIZE_PX, np.full(2, 900.0), CENTER, np.array([-0.2, 0.05, 0.0, 0.0, 0.0]))
FISHEYE = Camera(
    "fish", SIZE_PX, np.full(2, 300.0), CENTER, np.array([0.02, -0.01, 0.003, -0.001]), "fisheye"
)
APRILGRID = AprilGrid(tags=(6, 6), tag_mm=30, spacing=0.25)
CHARUCO = CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")
FACE = BoardSet.model_validate({"rigid": False, "faces": [{"name": "first", "board": CHARUCO}]})
NOISE_PX = 0.03
CLEAR_PX = 6
"""Distance of a corner from anything before it, from which on it is in the image as it is."""


def pose_board(board, lens, seed):
    """Return a pose before the camera that fills most of its image."""
    rng, middle = np.random.default_rng(seed), corner_points_mm(board).mean(axis=0)
    turn = Pose.of([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.3, 0.3)], np.zeros(3)).rotation
    across = np.ptp(corner_points_mm(board), axis=0).max()
    distance = across * (1.4 if lens is BROWN else 0.55)
    return Pose.placing(turn, middle, np.array([*rng.uniform(-0.1, 0.1, 2) * across, distance]))


def see_corners(board, lens, seed):
    """Return the corners (n, 3) mm and (n, 2) px that an image shows, a quarter of them missing, with noise."""
    rng, points = np.random.default_rng(seed), corner_points_mm(board)
    pixels = lens.project(pose_board(board, lens, seed).apply(points))
    shown = ((pixels > 0) & (pixels < SIZE_PX)).all(axis=1) & (rng.random(len(points)) < 0.75)
    return points[shown], pixels[shown] + rng.normal(0, NOISE_PX, (int(shown.sum()), 2))


@pytest.mark.parametrize("lens", [BROWN, FISHEYE], ids=["brown", "fisheye"])
@pytest.mark.parametrize("board", [APRILGRID, CHARUCO], ids=["aprilgrid", "charuco"])
def test_corners_at_other_crossings_are_left_out_and_no_others(board, lens):
    """Up to a tenth of the corners, neighbours among them, each off by 3 to 20 px."""
    lost = seen = 0
    for seed in range(count_examples(12)):
        on_board, pixels = see_corners(board, lens, seed)
        lost, seen = lost + int((~find_consistent(on_board, pixels, SIZE_PX)).sum()), seen + len(pixels)
        rng = np.random.default_rng(100 + seed)
        first = rng.integers(len(pixels))
        nearest = np.argsort(np.linalg.norm(on_board - on_board[first], axis=1))
        wrong = nearest[: 1 + rng.integers(len(pixels) // 10)]
        angle = rng.uniform(0, 2 * np.pi, len(wrong))
        shift = np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(3, 20, (len(wrong), 1))
        moved = pixels.copy()
        moved[wrong] += shift
        kept = find_consistent(on_board, moved, SIZE_PX)
        assert not kept[wrong].any(), seed
        lost, seen = lost + int((~kept).sum()) - len(wrong), seen + len(pixels)
    assert lost <= (0.02 * seen if lens is FISHEYE else 0)


def test_points_that_no_corner_was_found_at_are_placed_by_those_about_them():
    on_board, pixels = see_corners(APRILGRID, FISHEYE, 2)
    placed = place_corners(on_board[::2], pixels[::2], SIZE_PX, on_board[1::2])
    assert placed is not None
    assert np.percentile(np.linalg.norm(placed - pixels[1::2], axis=1), 90) < 0.3


def cover(image, corners, seed):
    """Return the image with four things before the board, and where they are (H, W)."""
    rng, size = np.random.default_rng(seed), np.ptp(corners, axis=0).max()
    light, covered = image.astype(float), np.zeros(image.shape, np.uint8)
    for _ in range(4):
        middle, mask = rng.uniform(corners.min(axis=0), corners.max(axis=0)), np.zeros(image.shape, np.uint8)
        if rng.random() < 0.4:
            reach = (
                size
                * rng.uniform(0.15, 0.4)
                * Pose.of([0, 0, rng.uniform(0, np.pi)], np.zeros(3)).rotation[:2, 0]
            )
            ends = [tuple(np.rint(middle + side * reach).astype(int).tolist()) for side in (-1, 1)]
            cv2.line(mask, ends[0], ends[1], 255, int(size * rng.uniform(0.02, 0.06)), cv2.LINE_AA)
        else:
            angles = np.sort(rng.uniform(0, 2 * np.pi, 6))
            outline = middle + np.column_stack([np.cos(angles), np.sin(angles)]) * size * rng.uniform(
                0.03, 0.12, (6, 1)
            )
            cv2.fillPoly(mask, [np.rint(outline).astype(np.int32)], 255, cv2.LINE_AA)
        share = cv2.GaussianBlur(mask, (0, 0), 0.8).astype(float) / 255
        light = (1 - share) * light + share * (
            rng.uniform(5, 250) + rng.normal(0, 20 * rng.random(), image.shape)
        )
        covered |= (share > 0.02).astype(np.uint8)
    return np.clip(np.rint(light), 0, 255).astype(np.uint8), covered


CASES = {
    "aprilgrid": (APRILGRID, BROWN, 0.4),
    "aprilgrid, fisheye": (APRILGRID, FISHEYE, 0.2),
    "charuco": (CHARUCO, BROWN, 0.3),
    "face": (FACE, BROWN, 0.3),
}
"""Board, lens, and the least share of the uncovered corners that is found: those of a tag that something touches are
not, as its number cannot be read."""


@pytest.mark.parametrize("name", list_cases(CASES, ["aprilgrid", "charuco"]))
def test_a_covered_board_keeps_its_view_and_no_corner_is_off(name):
    board, lens, least = CASES[name]
    plain = board.faces[0].board if isinstance(board, BoardSet) else board
    detect, points = make_detector(board, PrintVariant(False, False)), corner_points_mm(plain)
    found = uncovered = 0
    for seed in range(count_examples(10)):
        pose = pose_board(plain, lens, seed)
        true = lens.project(pose.apply(points))
        image, covered = cover(view(lens, pose, plain, Print(seed=seed)), true, seed)
        corners = detect(image)
        assert corners is not None, seed
        assert np.linalg.norm(corners.pixels - true[corners.ids], axis=1).max() < 0.5, seed
        distance = cv2.distanceTransform(1 - covered, cv2.DIST_L2, 5)
        inside = true[((true > CLEAR_PX) & (true < np.array(SIZE_PX) - 1 - CLEAR_PX)).all(axis=1)]
        column, row = np.rint(inside).astype(int).T
        found, uncovered = found + len(corners), uncovered + int((distance[row, column] > CLEAR_PX).sum())
    assert found > least * uncovered
