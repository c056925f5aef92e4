"""Robust bundle adjustment of a rig: accuracy, noise, outliers, and σ against the scatter of many rigs."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.calibration.assessment.covariance import compute_depth_sigma, compute_rig_covariance
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import score_rig_against_truth
from beltscape.kernels import load
from tests.synthetic.detections import make_detections, replace_view
from tests.thorough import count_examples

NOISE_PX = 0.1


@pytest.fixture(scope="module")
def adjusted(rig, board, poses):
    own = make_detections(rig, board, poses, NOISE_PX)
    chain = solve_hierarchy(own, board, rig.core, Silent())
    return chain, own, adjust_bundle(chain, board)


def test_bundle_adjustment_is_nearer_to_the_truth_than_the_hierarchy(rig, board, poses):
    better, seeds = 0, count_examples(5)
    for seed in range(seeds):
        own = make_detections(rig, board, poses, NOISE_PX, seed)
        chain = solve_hierarchy(own, board, rig.core, Silent())
        before = score_rig_against_truth(chain.rig, rig, load())
        after = score_rig_against_truth(adjust_bundle(chain, board).rig, rig, load())
        better += after.depth_rms_mm < before.depth_rms_mm
        assert max(after.rotation_deg.values()) < max(before.rotation_deg.values())
    assert better >= 0.8 * seeds


def test_a_flat_board_stays_flat_and_the_noise_is_estimated(adjusted):
    _, _, found = adjusted
    assert not found.shape_mm.any()
    np.testing.assert_allclose(found.sigma_px, NOISE_PX, rtol=0.1)
    assert found.used.mean() > 0.99


def test_wrong_corners_are_left_out(rig, board, poses):
    own = make_detections(rig, board, poses, NOISE_PX)
    first = next(iter(rig.cameras))
    pixels = own.views[first]["03"].pixels.copy()
    pixels[4] += 1.2
    disturbed = replace_view(own, first, "03", pixels)
    chain = solve_hierarchy(disturbed, board, rig.core, Silent())
    found = adjust_bundle(chain, board)
    o = found.bundle.observations
    camera = list(found.rig.cameras).index(first)
    of_view = (o.camera == camera) & (o.frame == found.frames.index("03"))
    assert not found.used[of_view][4]
    assert found.used[of_view].sum() == of_view.sum() - 1


@pytest.mark.thorough
def test_depth_sigma_equals_the_scatter_of_many_rigs(rig, board, poses, adjusted):
    _, _, found = adjusted
    sigma = compute_depth_sigma(found.rig, compute_rig_covariance(found).matrix, 650.0, columns=9)
    inner = (slice(2, -2), slice(2, -2))
    x, y = np.meshgrid(sigma.x_mm, sigma.y_mm)
    points = np.stack([x[inner].ravel(), y[inner].ravel(), np.full(x[inner].size, 650.0)], axis=-1)
    errors = []
    for seed in range(count_examples(24)):
        own = make_detections(rig, board, poses, NOISE_PX, 100 + seed)
        again = adjust_bundle(solve_hierarchy(own, board, rig.core, Silent()), board).rig
        errors.append(triangulate_with(again, rig, points)[:, 2] - 650.0)
    actual = np.sqrt(np.nanmean(np.square(errors), axis=0))
    ratio = actual / sigma.sigma_mm[inner].ravel()
    assert 0.7 < np.nanmedian(ratio) < 1.4


def triangulate_with(rig, truth, points_mm):
    """Points seen by the true cameras and triangulated with another rig."""
    pixels = []
    for name, camera in truth.cameras.items():
        seen = camera.project(truth.cam_from_core[name].apply(points_mm))
        seen[((seen < 0) | (seen > np.array(camera.size_px) - 1)).any(axis=1)] = np.nan
        pixels.append(
            rig.cameras[name].undistort(seen) * rig.cameras[name].focal_px + rig.cameras[name].center_px
        )
    order = list(truth.cameras)
    return load().triangulate(np.stack([rig.projection(name) for name in order]), np.stack(pixels))


def test_covariance_names_every_parameter_and_is_zero_for_fixed_ones(adjusted):
    _, _, found = adjusted
    covariance = compute_rig_covariance(found)
    cameras = len(found.rig.cameras)
    assert len(covariance.parameters) == 9 * cameras + 6 * (cameras - 1) == len(covariance.matrix)
    np.testing.assert_array_equal(covariance.matrix, covariance.matrix.T)
    variances = dict(zip(covariance.parameters, np.diag(covariance.matrix), strict=True))
    for name in found.rig.cameras:
        assert variances[f"{name}.fx_px"] > 0
        assert variances[f"{name}.k3"] == 0
