"""Bundle adjustment: derivatives, the linear model, and exact recovery of a rig."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from beltscape.calibration.solver.bundle import Bundle
from beltscape.calibration.solver.lens import (
    differentiate_by_pose,
    pack_intrinsics,
    project_points,
    project_with_jacobians,
)
from beltscape.calibration.solver.levenberg_marquardt import minimise, single_thread
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import rotation_from_vector
from tests.synthetic.bundles import make_problem
from tests.thorough import count_examples

NOISE_PX = 0.1


def test_projection_equals_opencv():
    rng = np.random.default_rng(3)
    points = rng.uniform([-200, -200, 500], [200, 200, 900], (50, 3))
    lens = np.array([900.0, 910.0, 320.0, 240.0, -0.2, 0.1, 0.002, -0.001, 0.03])
    pixels, _, _ = project_with_jacobians(points, np.tile(lens, (50, 1)))
    matrix = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, lens[4:])[0].reshape(-1, 2)
    np.testing.assert_allclose(pixels, expected, atol=1e-9)


def test_projection_equals_the_camera_model():
    rng = np.random.default_rng(5)
    points = rng.uniform([-200, -200, 500], [200, 200, 900], (50, 3))
    camera = Camera(
        "a", (640, 480), np.array([900.0, 910.0]), np.array([320.0, 240.0]),
        np.array([-0.2, 0.1, 0.002, -0.001, 0.03]),
    )  # fmt: skip
    lens = pack_intrinsics(camera)
    expected = camera.project(points)
    np.testing.assert_allclose(project_points(points, lens), expected, rtol=1e-13)
    np.testing.assert_allclose(project_with_jacobians(points, lens)[0], expected, rtol=1e-13)


def test_derivatives_equal_numeric_ones():
    rng = np.random.default_rng(4)
    points = rng.uniform([-250, -200, 500], [250, 200, 900], (20, 3))
    lens = np.tile([900.0, 910.0, 320.0, 240.0, -0.2, 0.1, 0.002, -0.001, 0.03], (20, 1))
    _, by_point, by_lens = project_with_jacobians(points, lens)
    for axis in range(3):
        h = np.eye(3)[axis] * 1e-4
        numeric = (
            project_with_jacobians(points + h, lens)[0] - project_with_jacobians(points - h, lens)[0]
        ) / 2e-4
        np.testing.assert_allclose(by_point[:, :, axis], numeric, rtol=1e-6, atol=1e-7)
    for parameter in range(9):
        h = np.eye(9)[parameter] * 1e-5
        numeric = (
            project_with_jacobians(points, lens + h)[0] - project_with_jacobians(points, lens - h)[0]
        ) / 2e-5
        np.testing.assert_allclose(by_lens[:, :, parameter], numeric, rtol=1e-5, atol=1e-6)
    turned = differentiate_by_pose(by_point, points)
    for axis in range(3):
        h = np.eye(3)[axis] * 1e-6
        forth, back = (
            project_with_jacobians(points @ rotation_from_vector(s * h).T, lens)[0] for s in (1, -1)
        )
        np.testing.assert_allclose(turned[:, :, axis], (forth - back) / 2e-6, rtol=1e-5, atol=1e-4)


def test_the_linear_model_predicts_the_decrease_of_a_small_step(rig, board, poses):
    observations, truth, prior = make_problem(rig, board, poses, NOISE_PX, points_sigma_mm=0.1)
    bundle = Bundle(observations, prior)
    linear = bundle.linearise(truth)
    step = linear.solve_step(0.1)
    for share in (1e-3, 1e-4):
        brought = linear.cost - bundle.compute_cost(bundle.apply_step(truth, share * step))
        assert brought == pytest.approx(linear.predict_decrease(share * step), rel=1e-2)


def test_exact_views_restore_a_perturbed_rig(rig, board, poses):
    observations, truth, prior = make_problem(rig, board, poses)
    bundle = Bundle(observations, prior)
    rng = np.random.default_rng(5)
    scales = np.concatenate(
        [np.tile([1, 1, 1, 1, 1e-3, 1e-3, 1e-4, 1e-4], len(rig.cameras)),
         np.tile([1e-3] * 3 + [0.5] * 3, len(rig.cameras) - 1 + len(poses))]
    )  # fmt: skip
    start = bundle.apply_step(truth, scales * rng.normal(size=len(scales)))
    found = minimise(bundle, start)
    assert found.converged
    np.testing.assert_allclose(found.state.intrinsics[:, :4], truth.intrinsics[:, :4], atol=1e-4)
    np.testing.assert_allclose(found.state.cam_translation_mm, truth.cam_translation_mm, atol=1e-4)
    np.testing.assert_allclose(found.state.cam_rotation, truth.cam_rotation, atol=1e-7)


def test_a_warped_board_is_estimated_up_to_its_gauge(rig, board, poses):
    _, flat, _ = make_problem(rig, board, poses)
    x, y = (flat.points_mm[:, :2] / flat.points_mm[:, :2].max(axis=0)).T
    warp = np.stack([np.zeros_like(x), np.zeros_like(x), 0.4 * (x * x - y * x)], axis=-1)
    observations, truth, prior = make_problem(
        rig, board, poses, points_mm=flat.points_mm + warp, points_sigma_mm=10.0
    )
    found = minimise(Bundle(observations, prior), replace(truth, points_mm=flat.points_mm))
    points = found.state.points_mm - found.state.points_mm.mean(axis=0)
    expected = truth.points_mm - truth.points_mm.mean(axis=0)
    u, _, vt = np.linalg.svd(points.T @ expected)
    aligned = points @ (u @ vt)
    aligned *= np.linalg.norm(expected) / np.linalg.norm(aligned)
    np.testing.assert_allclose(aligned, expected, atol=2e-3)


def test_fixed_parameters_do_not_change(rig, board, poses):
    observations, truth, prior = make_problem(rig, board, poses, NOISE_PX)
    held = replace(prior, intrinsics_free=np.zeros_like(prior.intrinsics_free))
    found = minimise(Bundle(observations, held), truth)
    np.testing.assert_array_equal(found.state.intrinsics, truth.intrinsics)
    np.testing.assert_array_equal(found.state.points_mm, truth.points_mm)


def test_corners_of_weight_zero_have_no_effect(rig, board, poses):
    observations, truth, prior = make_problem(rig, board, poses, NOISE_PX)
    bad = np.arange(len(observations.pixels)) % 17 == 0
    spoiled = replace(observations, pixels=observations.pixels + 50.0 * bad[:, None])
    one = minimise(Bundle(observations, prior, (~bad).astype(float)), truth).state
    two = minimise(Bundle(spoiled, prior, (~bad).astype(float)), truth).state
    np.testing.assert_allclose(one.cam_translation_mm, two.cam_translation_mm, atol=1e-6)


def test_covariance_equals_the_scatter_of_many_runs(rig, board, poses):
    """Normalised squared error over degrees of freedom, over seeds: 0.9 to 1.1."""
    ratios = []
    with single_thread():
        for seed in range(count_examples(60)):
            observations, truth, prior = make_problem(rig, board, poses[:8], NOISE_PX, seed)
            bundle = Bundle(observations, prior)
            state = minimise(bundle, truth).state
            covariance = bundle.linearise(state).covariance()
            cams = np.concatenate(
                [
                    np.stack(
                        [_turn(a @ b.T) for a, b in zip(state.cam_rotation, truth.cam_rotation, strict=True)]
                    ),
                    state.cam_translation_mm - truth.cam_translation_mm,
                ],
                axis=1,
            )[1:]
            error = np.concatenate([(state.intrinsics - truth.intrinsics)[:, :8].ravel(), cams.ravel()])
            ratios.append(error @ np.linalg.solve(covariance, error) / len(error))
    assert 0.9 < np.mean(ratios) < 1.1


def _turn(rotation):
    """A small rotation (3, 3) as a vector (3,)."""
    skew = (rotation - rotation.T) / 2
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
