"""Resection of a board by all cameras of a rig."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.network.resection import fit_board_pose
from beltscape.target.board import corner_points_mm
from tests.synthetic.detections import make_detections


def off(found, true):
    """(degrees, mm) between two poses."""
    between = found @ true.inverse()
    return between.angle_deg, float(np.linalg.norm(found.translation_mm - true.translation_mm))


@pytest.mark.parametrize("frame", [0, 3, 7])
def test_exact_corners_give_the_exact_pose(rig, board, poses, frame):
    own = make_detections(rig, board, poses)
    views = {n: v[f"{frame:02d}"] for n, v in own.views.items() if f"{frame:02d}" in v}
    angle, distance = off(fit_board_pose(rig, views, corner_points_mm(board)), poses[frame])
    assert angle < 1e-6
    assert distance < 1e-5


def test_more_cameras_give_a_better_pose(rig, board, poses):
    one, all_of_them = [], []
    for seed in range(12):
        own = make_detections(rig, board, poses, 0.2, seed)
        views = {n: v["03"] for n, v in own.views.items() if "03" in v}
        first = dict(list(views.items())[:1])
        one.append(off(fit_board_pose(rig, first, corner_points_mm(board)), poses[3])[1])
        all_of_them.append(off(fit_board_pose(rig, views, corner_points_mm(board)), poses[3])[1])
    assert np.mean(all_of_them) < 0.6 * np.mean(one)


def test_the_pose_is_a_minimum(rig, board, poses):
    own = make_detections(rig, board, poses, 0.2)
    views = {n: v["05"] for n, v in own.views.items() if "05" in v}
    corners = corner_points_mm(board)
    found = fit_board_pose(rig, views, corners)

    def cost(pose, seen: dict[str, Corners]):
        return sum(
            (
                (rig.cameras[n].project((rig.cam_from_core[n] @ pose).apply(corners[c.ids])) - c.pixels) ** 2
            ).sum()
            for n, c in seen.items()
        )

    best = cost(found, views)
    for axis in range(3):
        for step in (-1e-3, 1e-3):
            shift = np.zeros(3)
            shift[axis] = step
            assert cost(type(found)(found.rotation, found.translation_mm + shift), views) >= best
