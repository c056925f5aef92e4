"""Binocular calibration: poses of pairs, and frames that are rejected."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.calibration.intrinsics.zhang import MonocularCalibration, calibrate_camera
from beltscape.calibration.network.pairs import Pair, calibrate_pair, calibrate_pairs
from beltscape.calibration.network.pose_chains import log
from beltscape.calibration.solver.lens import list_parameters
from beltscape.core.geometry.pose import Pose
from beltscape.core.progress import Silent
from beltscape.target.board import corner_points_mm
from tests.optional import require
from tests.synthetic.detections import make_detections, project_corners, replace_view
from tests.thorough import count_examples


@pytest.fixture(scope="module")
def board_mm(board):
    return corner_points_mm(board)


def calibrate_first_pair(own, board_mm, first="a", second="b") -> Pair | None:
    cameras = {name: calibrate_camera(name, own, board_mm) for name in (first, second)}
    return calibrate_pair(own, cameras[first], cameras[second], board_mm)


def test_without_noise_the_pose_is_exact(rig, board, poses, board_mm):
    pair = require(calibrate_first_pair(make_detections(rig, board, poses), board_mm))
    offset = pair.second_from_first.inverse() @ rig.relative_pose("b", "a")
    assert offset.angle_deg < 1e-4
    assert np.linalg.norm(offset.translation_mm) < 1e-3
    assert pair.rms_px < 1e-4
    assert (pair.frames, pair.corners) == (tuple(f"{i:02d}" for i in range(12)), 12 * 35)


def test_every_pair_that_shares_views_is_calibrated(rig, board, poses, board_mm):
    own = make_detections(rig, board, poses, noise_px=0.05)
    cameras = {name: calibrate_camera(name, own, board_mm) for name in rig.cameras}
    pairs = calibrate_pairs(own, cameras, board_mm, Silent())
    assert [(p.first, p.second) for p in pairs] == [
        ("a", "b"), ("a", "c"), ("a", "d"), ("b", "c"), ("b", "d"), ("c", "d"),
    ]  # fmt: skip


def test_cameras_without_a_common_frame_make_no_pair(rig, board, poses, board_mm):
    frames = {"a": range(6), "b": range(6, 12), "c": (), "d": ()}
    assert calibrate_first_pair(make_detections(rig, board, poses, seen_by=frames), board_mm) is None


def test_frames_with_too_few_common_corners_are_not_used(rig, board, poses, board_mm):
    own = make_detections(rig, board, poses)
    views = {name: dict(frames) for name, frames in own.views.items()}
    for name, kept in (("a", slice(0, 20)), ("b", slice(15, 35))):  # they share corners 15 to 19 only
        corners = views[name]["00"]
        views[name]["00"] = type(corners)(corners.ids[kept], corners.pixels[kept])
    pair = require(calibrate_first_pair(type(own)(own.sizes_px, views, own.images), board_mm))
    assert "00" not in pair.frames
    assert len(pair.frames) == 11


def test_a_frame_in_which_the_board_moved_is_rejected_and_reported(rig, board, poses, board_mm):
    own = make_detections(rig, board, poses, noise_px=0.05)
    moved = Pose(poses[4].rotation, poses[4].translation_mm + np.array([4.0, 0.0, 0.0]))
    late = project_corners(rig, "b", moved, board_mm, np.zeros((35, 2)))
    pair = require(calibrate_first_pair(replace_view(own, "b", "04", late.pixels), board_mm))
    assert list(pair.rejected) == ["04"]
    assert pair.rejected["04"].startswith("RMS ")
    assert " px in the pair, the median frame has " in pair.rejected["04"]
    assert "04" not in pair.frames
    offset = pair.second_from_first.inverse() @ rig.relative_pose("b", "a")
    assert np.linalg.norm(offset.translation_mm) < 4


def test_views_rejected_in_one_camera_do_not_enter_the_pair(rig, board, poses, board_mm):
    own = make_detections(rig, board, poses, noise_px=0.05)
    noise = np.random.default_rng(1).normal(0, 4, (35, 2))
    noisy = replace_view(own, "a", "07", own.views["a"]["07"].pixels + noise)
    pair = require(calibrate_first_pair(noisy, board_mm))
    assert "07" not in pair.frames
    assert pair.rejected == {}


def make_known_camera(rig, name, poses) -> MonocularCalibration:
    """A camera whose intrinsics are given, not estimated."""
    views = {f"{i:02d}": rig.cam_from_core[name] @ pose for i, pose in enumerate(poses)}
    return MonocularCalibration(
        rig.cameras[name], dict.fromkeys(list_parameters("brown"), 0.0), 0.1, views, dict.fromkeys(views, 0.1)
    )


def normalised_error(rig, pair) -> float:
    error = log(rig.relative_pose(pair.second, pair.first).inverse() @ pair.second_from_first)
    return float(error @ np.linalg.solve(pair.covariance, error)) / 6


def test_with_known_intrinsics_the_covariance_equals_that_of_the_errors(rig, board, poses, board_mm):
    first, second = (make_known_camera(rig, name, poses) for name in "ab")
    errors = []
    for seed in range(count_examples(60)):
        own = make_detections(rig, board, poses, noise_px=0.1, seed=seed)
        errors.append(normalised_error(rig, calibrate_pair(own, first, second, board_mm)))
    assert 0.8 < np.mean(errors) < 1.25


def test_with_estimated_intrinsics_the_covariance_contains_theirs(rig, board, poses, board_mm):
    """Fixed intrinsics would give a tenth of the true σ, most of which comes from the intrinsics."""
    errors, claimed = [], []
    for seed in range(count_examples(25)):
        own = make_detections(rig, board, poses, noise_px=0.1, seed=seed)
        pair = require(calibrate_first_pair(own, board_mm))
        errors.append(normalised_error(rig, pair))
        known = {name: make_known_camera(rig, name, poses) for name in "ab"}
        held = require(calibrate_pair(own, known["a"], known["b"], board_mm))
        claimed.append(np.sqrt(np.diag(pair.covariance) / np.diag(held.covariance)))
    assert 0.8 < np.mean(errors) < 1.25
    assert (np.mean(claimed, axis=0)[[0, 1, 5]] > 5).all()


def test_the_sensitivity_is_the_derivative_of_the_pose_by_the_corners(rig, board, poses, board_mm):
    """One corner moves by 0.2 px in the first camera; the pose changes as predicted, with new intrinsics."""
    own = make_detections(rig, board, poses, noise_px=0.05)
    before = require(calibrate_first_pair(own, board_mm))
    pixels = own.views["a"]["03"].pixels.copy()
    pixels[7] += [0.0, 0.2]
    after = require(calibrate_first_pair(replace_view(own, "a", "03", pixels), board_mm))
    moved = log(before.second_from_first.inverse() @ after.second_from_first)
    sigma = calibrate_camera("a", own, board_mm).rms_px / np.sqrt(2)
    row = 2 * (3 * 35 + 7) + 1
    sensitivity = before.sensitivity["a"]
    foretold = 0.2 * sensitivity[row] / sigma
    np.testing.assert_allclose(moved, foretold, rtol=0.1, atol=0.02 * np.abs(foretold[:3]).max())
    assert sensitivity.shape == (2 * 12 * 35, 6)
