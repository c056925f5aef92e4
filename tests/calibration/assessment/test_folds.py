"""Folds of cross-validation: frames of one pose of the board are on one side of every split."""

from __future__ import annotations

import numpy as np

from beltscape.calibration.assessment.cross_validation import cross_validate, list_folds
from beltscape.calibration.assessment.score import triangulate_corners
from beltscape.calibration.detection.board_poses import cluster_frames
from beltscape.core.geometry.pose import Pose
from beltscape.kernels import load
from beltscape.target.board import corner_points_mm
from tests.optional import require
from tests.synthetic.detections import make_detections, project_corners

NOISE_PX = 0.1


def nudge(pose: Pose, mm: float, seed: int) -> Pose:
    return Pose(pose.rotation, pose.translation_mm + np.random.default_rng(seed).normal(0, mm, 3))


def test_frames_of_a_board_at_rest_are_one_pose(rig, board, poses):
    at_rest = [nudge(pose, 0.1, i) for i, pose in enumerate(poses[:4]) for _ in range(3)]
    seen = make_detections(rig, board, at_rest, NOISE_PX)
    clusters = cluster_frames(seen, seen.frames)
    assert clusters == [tuple(f"{3 * i + k:02d}" for k in range(3)) for i in range(4)]
    assert len(cluster_frames(make_detections(rig, board, poses), seen.frames)) == len(poses)


def test_no_pose_is_in_two_folds(rig, board, poses):
    """The board rests for two frames in every pose, out of order."""
    twice = [*poses, *poses[::-1]]
    seen = make_detections(rig, board, twice, NOISE_PX)
    (first, second), *_ = list_folds(seen, seen.frames)
    shown = [{min(int(frame), 23 - int(frame)) for frame in fold} for fold in (first, second)]
    assert not shown[0] & shown[1]
    assert sorted([*first, *second]) == sorted(seen.frames)


def test_repeated_frames_do_not_lower_the_held_out_score(rig, board, poses):
    """Three poses, eight frames each: halves of the frames would share all poses."""
    seen = make_detections(rig, board, [pose for pose in poses[:3] for _ in range(8)], NOISE_PX)
    assert list(list_folds(seen, seen.frames)) == []
    assert cross_validate(seen, board, "b", load()) is None


def test_triangulated_corners_have_the_least_reprojection_error(rig, board, poses):
    """Every corner's gradient of the squared errors in the distorted images is zero."""
    board_mm, rng = corner_points_mm(board), np.random.default_rng(3)
    views = {
        name: project_corners(rig, name, poses[2], board_mm, rng.normal(0, 0.5, (len(board_mm), 2)))
        for name in rig.cameras
    }
    points = triangulate_corners(rig, views, len(board_mm), load())
    for corner in np.flatnonzero(np.isfinite(points).all(axis=1)):
        costs = [_compute_cost(rig, views, int(corner), points[corner] + step) for step in _list_steps(0.01)]
        assert min(costs) >= _compute_cost(rig, views, int(corner), points[corner])


def _list_steps(mm: float) -> np.ndarray:
    return mm * np.concatenate([np.eye(3), -np.eye(3)])


def _compute_cost(rig, views, corner: int, point: np.ndarray) -> float:
    total = 0.0
    for name, corners in views.items():
        seen = corners.pixels[corners.ids == corner]
        projected = rig.cameras[name].project(rig.cam_from_core[name].apply(point[None]))
        total += float(((seen - projected) ** 2).sum())
    return total


def test_more_folds_are_tried_if_half_of_the_frames_do_not_suffice(rig, board, poses):
    seen_by = {name: range(6) for name in rig.cameras} | {"a": range(0, 6, 2)}
    seen = make_detections(rig, board, poses[:6], NOISE_PX, seen_by=seen_by)
    assert require(cross_validate(seen, board, "b", load())).score.frames == 6
