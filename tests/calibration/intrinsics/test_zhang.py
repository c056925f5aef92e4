"""Zhang's method: recovery of a camera, its σ, and rejected views."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.intrinsics.zhang import calibrate_camera
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import corner_points_mm
from tests.synthetic.boards import board_poses, row_of_cameras
from tests.synthetic.detections import make_detections, replace_view


@pytest.fixture(scope="module")
def board_mm(board):
    return corner_points_mm(board)


def test_without_noise_the_camera_is_recovered(rig, board, poses, board_mm):
    seen = make_detections(rig, board, poses)
    for name, true in rig.cameras.items():
        found = calibrate_camera(name, seen, board_mm)
        np.testing.assert_allclose(found.camera.focal_px, true.focal_px, atol=1e-3)
        np.testing.assert_allclose(found.camera.center_px, true.center_px, atol=2e-3)
        np.testing.assert_allclose(found.camera.distortion[[0, 2, 3]], true.distortion[[0, 2, 3]], atol=1e-5)
        assert found.camera.size_px == true.size_px
        assert found.rms_px < 1e-4
        assert (found.fixed, found.rejected) == (("k3",), {})
        for frame, pose in found.cam_from_board.items():
            offset = (rig.cam_from_core[name] @ poses[int(frame)]).inverse() @ pose
            assert np.linalg.norm(offset.translation_mm) < 0.01


def test_the_rms_equals_the_noise(rig, board, poses, board_mm):
    found = calibrate_camera("a", make_detections(rig, board, poses, noise_px=0.1), board_mm)
    assert found.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    assert set(found.view_rms_px) == set(found.cam_from_board)


def test_sigma_equals_the_errors_of_the_parameters(rig, board, poses, board_mm):
    deviations = []
    for seed in range(10):
        found = calibrate_camera("a", make_detections(rig, board, poses, noise_px=0.1, seed=seed), board_mm)
        off = [
            *(found.camera.focal_px - rig.cameras["a"].focal_px),
            *(found.camera.center_px - rig.cameras["a"].center_px),
        ]
        deviations.append([o / found.sigma[k] for o, k in zip(off, ("fx", "fy", "cx", "cy"), strict=True)])
    assert 0.6 < float(np.sqrt(np.mean(np.square(deviations)))) < 1.5


def test_k3_is_estimated_if_the_images_determine_it(rig, board, poses, board_mm):
    lens = replace(rig.cameras["a"], distortion=np.array([-0.3, 0.15, 0.0, 0.0, -0.2]))
    bent = Rig("a", {"a": lens}, {"a": rig.cam_from_core["a"]})
    many = [*poses, *board_poses(board, 12, distance_mm=520, seed=9)]
    found = calibrate_camera("a", make_detections(bent, board, many, noise_px=0.02), board_mm)
    assert found.fixed == ()
    assert found.camera.distortion[4] == pytest.approx(-0.2, abs=4 * found.sigma["k3"])


def test_a_view_that_does_not_fit_is_rejected_and_reported(rig, board, poses, board_mm):
    clean = make_detections(rig, board, poses, noise_px=0.05)
    rng = np.random.default_rng(0)
    bad = replace_view(clean, "a", "03", clean.views["a"]["03"].pixels + rng.normal(0, 3, (35, 2)))
    found = calibrate_camera("a", bad, board_mm)
    assert list(found.rejected) == ["03"]
    assert "03" not in found.cam_from_board
    assert len(found.cam_from_board) == 11
    assert re.fullmatch(r"reprojection RMS 3\.\d\d px, the median view has 0\.\d\d px", found.rejected["03"])
    np.testing.assert_allclose(found.camera.focal_px, rig.cameras["a"].focal_px, atol=3)


def test_a_rejected_view_is_compared_with_the_median_view(rig, board, poses, board_mm):
    own = make_detections(rig, board, poses)
    pixels = own.views["a"]["03"].pixels.copy()
    pixels[17] += [6.0, 0.0]  # one corner of 35 is off: RMS 1.0 px, while the others fit to 0.0 px
    found = calibrate_camera("a", replace_view(own, "a", "03", pixels), board_mm)
    assert re.fullmatch(r"reprojection RMS 0\.9\d px, the median view has 0\.0\d px", found.rejected["03"])


def test_too_few_views_are_refused(rig, board, poses, board_mm):
    seen = make_detections(
        rig, board, poses, seen_by={n: (range(2) if n == "b" else range(12)) for n in rig.cameras}
    )
    with pytest.raises(CalibrationError) as error:
        calibrate_camera("b", seen, board_mm)
    assert str(error.value) == (
        "camera b sees the board in 2 of 12 images; at least 3 tilted views are needed"
    )


def test_partly_visible_boards_suffice(board, board_mm):
    rig = row_of_cameras(["a"])
    near = board_poses(board, 14, distance_mm=420, seed=2)
    seen = make_detections(rig, board, near, noise_px=0.02)
    assert min(len(corners) for corners in seen.views["a"].values()) < 35
    found = calibrate_camera("a", seen, board_mm)
    np.testing.assert_allclose(found.camera.focal_px, rig.cameras["a"].focal_px, atol=1.5)
