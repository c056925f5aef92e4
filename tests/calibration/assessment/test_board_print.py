"""Prints that are stretched, or whose gaps are not as described: measured from the board's shape, with their σ."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.board_print import (
    PrintDistortion,
    compute_corner_covariance,
    describe_print,
    measure_print,
)
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult, adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.progress import Silent
from beltscape.target.board import AprilGrid, Chessboard, PlanarBoard, corner_points_mm
from tests.synthetic.boards import board_poses, row_of_cameras

NOISE_PX = 0.03
RIG = row_of_cameras(["a", "b", "c"])
CHESSBOARD = Chessboard(corners=(9, 6), square_mm=30)
GRID = AprilGrid(tags=(6, 4), tag_mm=30, spacing=0.3)


def adjust_views(
    board: PlanarBoard, printed_mm: np.ndarray, seed: int = 0, frames: int = 14
) -> BundleAdjustmentResult:
    """Return the adjustment of views of a print with corners (P, 3), which is taken for a board."""
    rng, views = np.random.default_rng(seed), dict[str, dict[str, Corners]]()
    for name, camera in RIG.cameras.items():
        views[name] = {}
        for i, pose in enumerate(board_poses(board, frames)):
            pixels = camera.project((RIG.cam_from_core[name] @ pose).apply(printed_mm))
            pixels += rng.normal(0, NOISE_PX, pixels.shape)
            inside = ((pixels > 0) & (pixels < np.array(camera.size_px) - 1)).all(axis=1)
            if inside.sum() > 12:
                views[name][f"{i:02d}"] = Corners(np.flatnonzero(inside), pixels[inside])
    sizes = {name: camera.size_px for name, camera in RIG.cameras.items()}
    seen = BoardDetections(sizes, views, dict.fromkeys(sizes, frames))
    models = dict.fromkeys(RIG.cameras, "brown")
    return adjust_bundle(solve_hierarchy(seen, board, RIG.core, Silent(), lens_models=models), board)


def measure(board: PlanarBoard, found: BundleAdjustmentResult) -> PrintDistortion:
    return measure_print(board, found.geometry.points_mm, compute_corner_covariance(found))


@pytest.mark.parametrize("stretch", [4e-3, -2e-3])
def test_a_stretched_print_is_measured_with_its_sigma(stretch):
    found = adjust_views(CHESSBOARD, corner_points_mm(CHESSBOARD) * [1 + stretch, 1, 1])
    measured = measure(CHESSBOARD, found)
    assert abs(measured.stretch - stretch) < 3 * measured.stretch_sigma
    assert measured.stretch_sigma < 0.2 * abs(stretch)
    (line,) = describe_print(CHESSBOARD, found, 1.0)
    assert f"the board is stretched: its rows are {abs(measured.stretch):.2%} ± " in line
    assert f"{'longer' if stretch > 0 else 'shorter'} than its columns" in line
    for name, camera in found.rig.cameras.items():  # 8e-4 where each corner is off by itself
        aspect, true = (own.focal_px[1] / own.focal_px[0] for own in (camera, RIG.cameras[name]))
        assert aspect / true == pytest.approx(1, abs=4e-4)
    # what the line says of the rig's size: the true baseline over the found one, if square_mm is right along rows
    long = np.linalg.norm(found.rig.cam_from_core["c"].center_mm)
    true = np.linalg.norm(RIG.cam_from_core["c"].center_mm)
    assert long / true * (1 + stretch) == pytest.approx(1 + measured.rows, abs=6e-4)


def test_the_right_square_makes_the_rig_right():
    """The square of the rows over the factor that the line states."""
    printed = corner_points_mm(CHESSBOARD) * [1, 1.004, 1]
    first = adjust_views(CHESSBOARD, printed)
    factor = 1 + measure(CHESSBOARD, first).rows
    (line,) = describe_print(CHESSBOARD, first, 1.0)
    assert f"give square_mm of the row over {factor:.5f}" in line
    again = adjust_views(CHESSBOARD.model_copy(update={"square_mm": 30 / factor}), printed)
    true = np.linalg.norm(RIG.cam_from_core["c"].center_mm)
    assert np.linalg.norm(again.rig.cam_from_core["c"].center_mm) == pytest.approx(true, rel=4e-4)
    assert abs(np.linalg.norm(first.rig.cam_from_core["c"].center_mm) / true - 1) > 5e-4


@pytest.mark.parametrize("spacing", [0.2917, 0.31])
def test_other_gaps_than_described_are_named(spacing):
    printed = corner_points_mm(GRID.model_copy(update={"spacing": spacing}))
    found = adjust_views(GRID, printed)
    (line,) = describe_print(GRID, found, 1.0)
    stated = re.search(r"spacing is ([0-9.]+), board.toml says 0.3", line)
    assert stated
    assert float(stated[1]) == pytest.approx(spacing, abs=3e-4)
    measured = measure(GRID, found)
    size = np.linalg.norm(found.rig.cam_from_core["c"].center_mm) / np.linalg.norm(
        RIG.cam_from_core["c"].center_mm
    )
    assert size == pytest.approx(1 + (measured.rows + measured.columns) / 2 + measured.tag, abs=4e-4)
    assert ("too long if tag_mm is right" in line) == (size > 1)


@pytest.mark.parametrize("board", [CHESSBOARD, GRID], ids=["chessboard", "aprilgrid"])
def test_sound_and_bent_boards_have_no_contradiction(board):
    drawn = corner_points_mm(board)
    x, y, _ = ((drawn - drawn.mean(axis=0)) / 100).T
    bent = drawn + np.outer(0.4 * x**2 + 0.2 * x * y, [0, 0, 1.0])
    wrinkled = drawn + np.random.default_rng(1).normal(0, 0.05, drawn.shape) * [1, 1, 0]
    for k, printed in enumerate((drawn, bent, wrinkled)):
        found = adjust_views(board, printed, k)
        assert describe_print(board, found, 1.0) == []


def test_the_stated_sigma_is_the_scatter():
    errors = []
    for seed in range(6):
        found = adjust_views(CHESSBOARD, corner_points_mm(CHESSBOARD) * [1.003, 1, 1], seed)
        measured = measure(CHESSBOARD, found)
        errors.append((measured.stretch - 3e-3) / measured.stretch_sigma)
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) < 2.0


def test_a_board_as_drawn_is_not_looked_into():
    found = adjust_views(CHESSBOARD, corner_points_mm(CHESSBOARD) * [1.004, 1, 1])
    assert describe_print(CHESSBOARD, found, 1.0)
    assert not describe_print(CHESSBOARD, replace(found, shape_mm=0 * found.shape_mm), 1.0)
    assert not describe_print(CHESSBOARD, found, 10.0), "within 4 σ"
