from __future__ import annotations

import numpy as np
import pytest

from beltscape.calibrate.intrinsics import calibrate_camera
from beltscape.calibrate.pairs import calibrate_pair, calibrate_pairs
from beltscape.core.pose import Pose
from beltscape.core.progress import Silent
from beltscape.target.board import corner_points_mm
from synthetic.sightings import seen, sightings, spoiled


@pytest.fixture(scope="module")
def board_mm(board):
    return corner_points_mm(board)


def pair_of(own, board_mm, first="a", second="b"):
    cameras = [calibrate_camera(name, own, board_mm) for name in (first, second)]
    return calibrate_pair(own, *cameras, board_mm)


def test_without_noise_the_pose_is_exact(rig, board, poses, board_mm):
    pair = pair_of(sightings(rig, board, poses), board_mm)
    offset = pair.second_from_first.inverse() @ rig.relative("b", "a")
    assert offset.angle_deg < 1e-4
    assert np.linalg.norm(offset.translation_mm) < 1e-3
    assert pair.rms_px < 1e-4
    assert (pair.frames, pair.corners) == (tuple(f"{i:02d}" for i in range(12)), 12 * 35)


def test_every_pair_that_shares_views_is_found(rig, board, poses, board_mm):
    own = sightings(rig, board, poses, noise_px=0.05)
    cameras = {name: calibrate_camera(name, own, board_mm) for name in rig.cameras}
    pairs = calibrate_pairs(own, cameras, board_mm, Silent())
    assert [(p.first, p.second) for p in pairs] == [
        ("a", "b"), ("a", "c"), ("a", "d"), ("b", "c"), ("b", "d"), ("c", "d"),
    ]  # fmt: skip


def test_cameras_without_a_common_frame_make_no_pair(rig, board, poses, board_mm):
    frames = {"a": range(6), "b": range(6, 12), "c": (), "d": ()}
    assert pair_of(sightings(rig, board, poses, seen_by=frames), board_mm) is None


def test_frames_with_too_few_common_corners_do_not_count(rig, board, poses, board_mm):
    own = sightings(rig, board, poses)
    views = {name: dict(frames) for name, frames in own.views.items()}
    for name, kept in (("a", slice(0, 20)), ("b", slice(15, 35))):  # they share corners 15 to 19 only
        corners = views[name]["00"]
        views[name]["00"] = type(corners)(corners.ids[kept], corners.pixels[kept])
    pair = pair_of(type(own)(own.sizes_px, views, own.images), board_mm)
    assert "00" not in pair.frames
    assert len(pair.frames) == 11


def test_a_frame_in_which_the_board_moved_is_left_out_and_named(rig, board, poses, board_mm):
    own = sightings(rig, board, poses, noise_px=0.05)
    moved = Pose(poses[4].rotation, poses[4].translation_mm + np.array([4.0, 0.0, 0.0]))
    late = seen(rig, "b", moved, board_mm, np.zeros((35, 2)))
    pair = pair_of(spoiled(own, "b", "04", late.pixels), board_mm)
    assert list(pair.rejected) == ["04"]
    assert pair.rejected["04"].startswith("RMS ")
    assert " px in the pair, the median frame has " in pair.rejected["04"]
    assert "04" not in pair.frames
    offset = pair.second_from_first.inverse() @ rig.relative("b", "a")
    assert np.linalg.norm(offset.translation_mm) < 4


def test_views_rejected_in_one_camera_do_not_enter_the_pair(rig, board, poses, board_mm):
    own = sightings(rig, board, poses, noise_px=0.05)
    noise = np.random.default_rng(1).normal(0, 4, (35, 2))
    pair = pair_of(spoiled(own, "a", "07", own.views["a"]["07"].pixels + noise), board_mm)
    assert "07" not in pair.frames
    assert pair.rejected == {}
