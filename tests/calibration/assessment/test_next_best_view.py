"""The next-best view: its predicted gain equals the gain with the view."""

from __future__ import annotations

from dataclasses import replace

import pytest

from beltscape.calibration.assessment.covariance import compute_rig_covariance
from beltscape.calibration.assessment.next_best_view import find_next_best_view
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.progress import Silent
from tests.optional import require
from tests.synthetic.detections import make_detections

NOISE_PX = 0.1


def calibrate_poses(rig, board, poses, seed=0):
    own = make_detections(rig, board, poses, NOISE_PX, seed)
    return adjust_bundle(solve_hierarchy(own, board, rig.core, Silent()), board)


@pytest.fixture(scope="module")
def few(rig, board, poses):
    return calibrate_poses(rig, board, poses[:6])


def test_the_predicted_sigma_equals_the_sigma_with_the_view(rig, board, poses, few):
    following = require(find_next_best_view(few, compute_rig_covariance(few)))
    assert not following.is_sufficient
    assert following.sigma_then_mm < following.sigma_now_mm
    more = calibrate_poses(rig, board, [*poses[:6], following.core_from_board])
    again = require(find_next_best_view(more, compute_rig_covariance(more)))
    assert again.sigma_now_mm == pytest.approx(following.sigma_then_mm, rel=0.25)


def test_the_description_fits_the_pose(rig, board, few):
    following = require(find_next_best_view(few, compute_rig_covariance(few)))
    assert len(following.seen_by) >= 2
    center = following.core_from_board.apply(few.geometry.points_mm).mean(axis=0)
    pixel = rig.core_camera.project(center)
    assert ("left" in following.placement.split(" of ")[0]) == (pixel[0] < 0.4 * rig.core_camera.size_px[0])
    assert following.describe().startswith("Next, hold the board in the ")


@pytest.mark.thorough
def test_many_views_leave_less_improvement(rig, board, poses, few):
    found = calibrate_poses(rig, board, [pose for _ in range(4) for pose in poses])
    now, before = (require(find_next_best_view(each, compute_rig_covariance(each))) for each in (found, few))
    assert now.sigma_now_mm < 0.5 * before.sigma_now_mm
    assert now.sigma_then_mm / now.sigma_now_mm > before.sigma_then_mm / before.sigma_now_mm


def test_the_two_sigmas_differ_in_what_is_shown(rig, board, few):
    following = require(find_next_best_view(few, compute_rig_covariance(few)))
    for now, then, shown in (
        (0.0034, 0.0027, "from 0.00340 to 0.00270 mm"),
        (0.2, 0.1, "from 0.200 to 0.100 mm"),
    ):
        said = replace(following, sigma_now_mm=now, sigma_then_mm=then).describe()
        assert said.endswith(f"the depth σ would fall {shown}.")


def test_sufficient_views_are_reported(rig, board, few):
    following = require(find_next_best_view(few, compute_rig_covariance(few)))
    little = replace(following, sigma_then_mm=0.98 * following.sigma_now_mm)
    assert little.is_sufficient
    assert little.describe() == (
        "Enough views: the most useful further one would lower the depth σ by 2.0% only."
    )
