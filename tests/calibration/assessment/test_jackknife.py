"""The jackknife over frames: no inflation for independent noise, the true one for common errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.covariance import compute_depth_sigma, compute_rig_covariance
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.target.board import corner_points_mm
from tests.synthetic.detections import make_detections
from tests.thorough import count_examples

NOISE_PX = 0.05


def detect_bending_board(rig, board, poses, amount_mm, seed):
    """Return detections of a board that bends differently in every frame."""
    own, rng = make_detections(rig, board, poses, NOISE_PX, seed), np.random.default_rng(1000 + seed)
    views = {name: dict(frames) for name, frames in own.views.items()}
    corners = corner_points_mm(board)
    x, y = ((corners - corners.mean(axis=0)) / np.ptp(corners, axis=0).max())[:, :2].T
    for frame, pose in enumerate(poses):
        a, b, c = amount_mm * rng.normal(size=3)
        shape = corners + np.stack([0 * x, 0 * x, 4 * (a * x**2 + b * x * y + c * y**2)], axis=1)
        for name, camera in rig.cameras.items():
            seen = own.views[name].get(f"{frame:02d}")
            if seen is not None:
                flat, curved = (
                    camera.project((rig.cam_from_core[name] @ pose).apply(p[seen.ids]))
                    for p in (corners, shape)
                )
                views[name][f"{frame:02d}"] = Corners(seen.ids, seen.pixels + curved - flat)
    return replace(own, views=views)


def found(rig, board, own):
    return adjust_bundle(solve_hierarchy(own, board, rig.core, Silent()), board)


def test_independent_noise_needs_no_inflation(rig, board, poses):
    raised = [
        compute_rig_covariance(
            found(rig, board, make_detections(rig, board, poses, NOISE_PX, seed))
        ).inflation
        for seed in range(count_examples(6))
    ]
    assert sum(r > 1 for r in raised) <= 1
    assert max(raised) < 2


@pytest.mark.thorough
def test_a_board_that_bends_between_views_inflates_sigma_to_the_true_error(rig, board, poses):
    errors, sigmas, raised = [], [], []
    for seed in range(count_examples(16)):
        each = found(rig, board, detect_bending_board(rig, board, poses, 0.5, seed))
        covariance = compute_rig_covariance(each)
        sigma = compute_depth_sigma(each.rig, covariance.matrix, 650.0, columns=9)
        x, y = np.meshgrid(sigma.x_mm, sigma.y_mm)
        points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 650.0)], axis=-1)
        errors.append(depth_errors(each.rig, rig, points))
        sigmas.append(sigma.sigma_mm.ravel())
        raised.append(covariance.inflation)
    ratio = np.sqrt(np.nanmean(np.square(errors)) / np.nanmean(np.square(sigmas)))
    assert np.median(raised) > 1.5
    assert 0.5 < ratio < 1.5


def depth_errors(rig, truth, points_mm):
    names = list(truth.cameras)
    pixels = np.stack([truth.project_into(rig, name, points_mm) for name in names])
    return (
        load().triangulate(np.stack([rig.projection(name) for name in names]), pixels)[:, 2] - points_mm[:, 2]
    )
