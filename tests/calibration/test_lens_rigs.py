"""Rigs whose cameras have different lens models: joint adjustment, covariance, and the domain of each lens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.covariance import compute_depth_jacobian, compute_rig_covariance
from beltscape.calibration.assessment.lens_domain import describe_domains, limit_domains
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.solver.lens import (
    group_by_model,
    list_parameters,
    project_points,
    project_with_jacobians,
    stack_intrinsics,
    unpack_intrinsics,
)
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.rig_limits import find_refusal
from tests.synthetic.boards import board_poses, row_of_cameras
from tests.synthetic.detections import make_detections

LENSES = {
    "brown": [-0.12, 0.06, 4e-4, -6e-4, 0.0],
    "rational": [0.9, 0.2, 3e-4, -2e-4, 0.01, 1.25, 0.45, 0.05],
    "thin_prism": [0.9, 0.2, 3e-4, -2e-4, 0.01, 1.25, 0.45, 0.05, 2e-3, -1e-3, -2e-3, 1e-3],
    "tilted": [-0.2, 0.1, 0.001, -0.002, 0.02, 0.1, -0.02, 0.03, 2e-3, -1e-3, -3e-3, 2e-3, 0.05, -0.04],
    "fisheye": [0.02, -0.01, 0.003, -0.001],
}
NOISE_PX = 0.03


def make_rig(models) -> Rig:
    rig = row_of_cameras(["a", "b", "c"], 90.0, 450.0)
    focal = {"brown": 520.0, "tilted": 520.0}
    cameras = {
        name: replace(
            camera,
            model=model,
            distortion=np.array(LENSES[model]),
            focal_px=np.full(2, focal.get(model, 250.0)),
        )
        for (name, camera), model in zip(rig.cameras.items(), models, strict=True)
    }
    return replace(rig, cameras=cameras)


def test_jacobians_of_mixed_models_equal_those_of_each():
    rig = make_rig(["fisheye", "brown", "tilted"])
    cameras, rng = list(rig.cameras.values()), np.random.default_rng(1)
    rows, index = stack_intrinsics(cameras), rng.integers(0, 3, 40)
    assert rows.shape == (3, 18)
    points = rng.uniform([-200, -150, 400], [200, 150, 700], (40, 3))
    groups = group_by_model([camera.model for camera in cameras], index)
    pixels, by_point, by_lens = project_with_jacobians(points, rows[index], groups)
    np.testing.assert_allclose(project_points(points, rows[index], groups), pixels, rtol=1e-14)
    for i, camera in enumerate(cameras):
        mine = index == i
        width = len(list_parameters(camera.model))
        own = project_with_jacobians(points[mine], rows[i, :width], camera.model)
        for found, expected in zip((pixels, by_point, by_lens[..., :width]), own, strict=True):
            np.testing.assert_allclose(found[mine], expected, rtol=1e-12)
        assert not by_lens[mine][..., width:].any()
        np.testing.assert_allclose(pixels[mine], camera.project(points[mine]), rtol=1e-12)
        np.testing.assert_array_equal(unpack_intrinsics(camera, rows[i]).distortion, camera.distortion)


@pytest.mark.parametrize("model", MODELS)
def test_derivatives_by_intrinsics_equal_differences(model):
    camera = make_rig([model] * 3).cameras["a"]
    points = np.random.default_rng(2).uniform([-150, -120, 400], [150, 120, 700], (15, 3))
    row = stack_intrinsics([camera])[0]
    _, by_point, by_lens = project_with_jacobians(points, row, model)
    for i, step in enumerate(np.eye(len(row)) * 1e-6):
        numeric = (
            project_points(points, row + step, model) - project_points(points, row - step, model)
        ) / 2e-6
        np.testing.assert_allclose(by_lens[:, :, i], numeric, rtol=1e-5, atol=2e-6)
    for axis, step in enumerate(np.eye(3) * 1e-4):
        numeric = (
            project_points(points + step, row, model) - project_points(points - step, row, model)
        ) / 2e-4
        np.testing.assert_allclose(by_point[:, :, axis], numeric, rtol=1e-5, atol=1e-7)


def test_a_rig_of_different_lenses_is_calibrated(board):
    true = make_rig(["fisheye", "brown", "rational"])
    poses = board_poses(board, 16, 450.0, x_mm=60.0)
    seen = make_detections(true, board, poses, NOISE_PX)
    models = {name: camera.model for name, camera in true.cameras.items()}
    hierarchy = solve_hierarchy(seen, board, "a", Silent(), lens_models=models)
    found = adjust_bundle(hierarchy, board)
    assert {name: camera.model for name, camera in found.rig.cameras.items()} == models
    np.testing.assert_allclose(found.sigma_px, NOISE_PX, rtol=0.15)
    for name in true.auxiliaries:
        off = found.rig.cam_from_core[name].center_mm - true.cam_from_core[name].center_mm
        assert np.linalg.norm(off) < 0.6
    covariance = compute_rig_covariance(found)
    count = sum(len(list_parameters(model)) for model in models.values()) + 12
    assert covariance.matrix.shape == (count, count) == (len(covariance.parameters),) * 2
    assert {"a.k4", "b.k3", "c.k6", "c.shift_z_mm"} <= set(covariance.parameters)
    jacobian = compute_depth_jacobian(found.rig, np.array([[30.0, 10.0, 450.0]]))
    sigma = float(np.sqrt(np.einsum("ni,ij,nj->n", jacobian, covariance.matrix, jacobian))[0])
    assert 0.001 < sigma < 0.5
    limited = limit_domains(found.rig, found)
    assert limited.cameras["b"].valid_radius_px is None
    reach_px = limited.cameras["a"].valid_radius_px
    assert reach_px is not None
    assert reach_px < 320
    assert find_refusal(limited) is None
    lines = describe_domains(limited.cameras)
    assert lines[0].startswith("camera a: its lens (fisheye) is known up to ")
    assert not any("camera b" in line for line in lines)
