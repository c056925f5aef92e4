"""Covariance by clusters of views: the model's for independent noise, the true one where noise is alike in a view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.covariance import (
    compute_camera_covariance,
    compute_clustered_covariance,
    compute_depth_jacobian,
    compute_formal_covariance,
    compute_rig_covariance,
)
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult, adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.intrinsics.lens_choice import calibrate_with_model
from beltscape.calibration.lens_review import set_up_alone
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.target.board import corner_points_mm
from tests.synthetic.camera_arrays import BOARD, boards_before, like_cameras
from tests.synthetic.correlated_noise import detect_correlated
from tests.thorough import count_examples

DEPTH_MM = 820.0


def make_belt() -> np.ndarray:
    x, y = np.meshgrid(np.linspace(-200, 200, 7), np.linspace(-150, 150, 5))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, DEPTH_MM)], axis=1)


def calibrate_rig(rig: Rig, seen: BoardDetections) -> BundleAdjustmentResult:
    models = dict.fromkeys(rig.cameras, "brown")
    return adjust_bundle(
        solve_hierarchy(seen, BOARD, "c00", Silent(), lens_models=models, is_start=True), BOARD
    )


def compute_sigma(found: BundleAdjustmentResult, covariance: np.ndarray) -> float:
    """Return the RMS σ of depth on the belt."""
    jacobian = compute_depth_jacobian(found.rig, make_belt())
    return float(np.sqrt(np.nanmean(np.einsum("ni,ij,nj->n", jacobian, covariance, jacobian))))


def measure_errors(true: Rig, found: Rig) -> np.ndarray:
    """Return the errors (N,) of depths on the belt that the found rig measures."""
    ideal = []
    for name, camera in found.cameras.items():
        pixels = true.cameras[name].project(true.cam_from_core[name].apply(make_belt()))
        ideal.append(camera.undistort(pixels) * camera.focal_px + camera.center_px)
    projections = np.stack([found.projection(name) for name in found.cameras])
    return load().triangulate(projections, np.stack(ideal), threads=1)[:, 2] - DEPTH_MM


@pytest.mark.parametrize(("alike_px", "least", "most"), [(0.0, 0.6, 1.5), (0.05, 3.0, 30.0)])
def test_clusters_of_views_find_noise_that_is_alike(alike_px, least, most):
    """Against the formal covariance of the corners' noise; the residuals themselves hardly tell the two apart."""
    rig = like_cameras(2, 1)
    found = calibrate_rig(rig, detect_correlated(rig, boards_before(rig, 8, 0.4, 3), 0, alike_px=alike_px))
    covariance = compute_rig_covariance(found)
    formal = covariance.matrix / covariance.inflation**2
    clustered = compute_clustered_covariance(found)
    np.testing.assert_allclose(clustered, clustered.T)
    assert np.linalg.eigvalsh(clustered)[0] > -1e-9 * np.trace(clustered)
    assert least < compute_sigma(found, clustered) / compute_sigma(found, formal) < most


@pytest.mark.thorough
def test_sigma_by_clusters_is_the_scatter_of_forty_captures():
    """Noise alike over 200 px, a board known to ± 0.1 mm, lenses just outside the model: 0.8 to 1.5 times."""
    rig = like_cameras(3, 1)
    lenses = {
        name: Camera(
            name, c.size_px, c.focal_px, c.center_px,
            np.array([*c.distortion[:4], 0.02, 0.0, 0.03, -0.02]), "rational",
        )
        for name, c in rig.cameras.items()
    }  # fmt: skip
    rig = replace(rig, cameras=lenses)
    poses = boards_before(rig, 12, 0.4, 3)
    errors, by_views, by_model = [], [], []
    for seed in range(40):
        found = calibrate_rig(rig, detect_correlated(rig, poses, seed, alike_px=0.05, board_mm=0.1))
        errors.append(measure_errors(rig, found.rig))
        by_views.append(compute_sigma(found, compute_clustered_covariance(found)))
        by_model.append(compute_sigma(found, compute_rig_covariance(found).matrix))
    scatter = float(np.sqrt(np.nanmean(np.square(errors))))
    assert 0.8 < np.sqrt(np.mean(np.square(by_views))) / scatter < 1.5
    assert np.sqrt(np.mean(np.square(by_model))) / scatter < 0.8


@pytest.mark.parametrize(("alike_px", "least", "most"), [(0.0, 0.35, 1.3), (0.05, 0.4, 1.6)])
def test_sigma_of_a_camera_alone_is_its_scatter(alike_px, least, most):
    """Focal lengths and principal point over their σ; by the corners' noise alone 3.2 where it is alike."""
    rig, errors, by_model = like_cameras(2, 1), list[np.ndarray](), list[np.ndarray]()
    true = rig.cameras["c00"]
    for seed in range(count_examples(12)):
        seen = detect_correlated(rig, boards_before(rig, 8, 0.4, 3), seed, alike_px=alike_px)
        alone = seen.restrict(("c00",), seen.frames)
        calibration, _ = calibrate_with_model("c00", alone, corner_points_mm(BOARD), "brown")
        found = set_up_alone(alone, calibration, corner_points_mm(BOARD))
        fitted = calibration.camera
        off = np.concatenate([fitted.focal_px - true.focal_px, fitted.center_px - true.center_px])
        errors.append(off / np.sqrt(np.diag(compute_camera_covariance(found))[:4]))
        formal = compute_formal_covariance(found.rig, found.bundle, found.linearise())
        by_model.append(off / np.sqrt(np.diag(formal)[:4]))
    assert least < np.sqrt(np.mean(np.square(errors))) < most
    assert (np.sqrt(np.mean(np.square(by_model))) > 1.8) == (alike_px > 0)
