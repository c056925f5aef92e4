"""Verdict on rigs that their views do not determine, and the count of what was left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.covariance import compute_rig_covariance
from beltscape.calibration.assessment.diagnosis import Diagnosis, diagnose
from beltscape.calibration.assessment.fit_quality import CameraFit
from beltscape.calibration.assessment.score import compute_rig_errors, summarise_errors
from beltscape.calibration.assessment.verdict import compute_focal_sigma, require_credible
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.target.board import list_triples
from tests.synthetic.camera_arrays import BOARD, boards_before, detect, like_cameras
from tests.thorough import list_cases, list_rows


def diagnose_views(seen: BoardDetections, known: dict[str, Camera] | None = None) -> Diagnosis:
    found = solve_hierarchy(seen, BOARD, None, Silent(), known=known)
    adjusted = adjust_bundle(found, BOARD)
    errors = compute_rig_errors(
        adjusted.rig, found.detections, BOARD, load(), corners_mm=adjusted.geometry.points_mm
    )
    covariance = compute_rig_covariance(adjusted)
    return diagnose(found, adjusted, covariance, list_triples(BOARD), errors, None)


@pytest.mark.parametrize(
    ("tilt_rad", "bend_mm"), [(0.01, 0.5), pytest.param(0.02, 0.0, marks=pytest.mark.thorough)]
)
def test_three_boards_square_to_parallel_cameras_determine_no_rig(tilt_rad, bend_mm):
    rig = like_cameras(4, 21, convergence=0.0)
    seen = detect(rig, boards_before(rig, 3, tilt_rad, 21), 0.05, 21, bend_mm)
    with pytest.raises(CalibrationError, match=r"focal length") as error:
        diagnose_views(seen)
    assert "3 positions of the board, tilted by 1° at most" in str(error.value)
    assert "photograph the board in 10 positions or more, tilted about 30° to every side" in str(error.value)


def test_the_same_boards_suffice_with_known_intrinsics():
    rig = like_cameras(4, 21, convergence=0.0)
    seen = detect(rig, boards_before(rig, 3, 0.02, 21), 0.05, 21)
    assert diagnose_views(seen, dict(rig.cameras)).findings == ()


@pytest.mark.parametrize("seed", list_cases([1, 2, 3], {1}))
def test_a_few_tilted_boards_determine_a_rig(seed):
    """The stated σ of the focal lengths covers their errors."""
    rig = like_cameras(4, seed)
    seen = detect(rig, boards_before(rig, 4, 0.3, seed), 0.05, seed, bend_mm=0.3)
    assert diagnose_views(seen).findings == ()
    adjusted = adjust_bundle(solve_hierarchy(seen, BOARD, None, Silent()), BOARD)
    sigma = compute_focal_sigma(adjusted, compute_rig_covariance(adjusted))
    for name, camera in adjusted.rig.cameras.items():
        assert abs(camera.focal_px - rig.cameras[name].focal_px).max() < 4 * sigma[name]


@pytest.mark.parametrize(("cameras", "positions"), list_rows([(6, 3), (20, 3), (20, 4), (20, 5)], {(6, 3)}))
def test_sigma_of_the_focal_length_is_a_few_times_its_error(cameras, positions):
    """Like cameras that see a large board at once: a view is worth more than a homography of its own."""
    rig = like_cameras(cameras, positions)
    seen = detect(rig, boards_before(rig, positions, 0.3, 1), 0.05, positions, bend_mm=0.3)
    adjusted = adjust_bundle(solve_hierarchy(seen, BOARD, None, Silent()), BOARD)
    sigma = compute_focal_sigma(adjusted, compute_rig_covariance(adjusted))
    errors = [adjusted.rig.cameras[name].focal_px[0] - each.focal_px[0] for name, each in rig.cameras.items()]
    typical = np.sqrt(np.mean(np.square(errors)))
    assert typical < 0.001 * 1058
    assert typical < np.sqrt(np.mean(np.square(list(sigma.values())))) < 4.5 * typical


@pytest.mark.thorough
def test_three_boards_square_to_twenty_cameras_determine_no_rig():
    rig = like_cameras(20, 2, convergence=0.0)
    seen = detect(rig, boards_before(rig, 3, 0.02, 2), 0.05, 2, bend_mm=0.5)
    with pytest.raises(CalibrationError, match="do not determine the focal length"):
        diagnose_views(seen)


def test_an_absurd_focal_length_is_not_stated(sound):
    adjusted, covariance, score = sound
    vague = replace(covariance, scatter=1000 * np.ones_like(covariance.scatter))
    with pytest.raises(
        CalibrationError, match="focal length of camera c00 not measurable, c01 not measurable: "
    ):
        require_credible(adjusted, vague, {}, score, score)


def test_views_of_a_single_board_pose_are_refused():
    rig = like_cameras(2, 5)
    with pytest.raises(CalibrationError, match="do not determine the focal length of camera c0") as error:
        diagnose_views(detect(rig, boards_before(rig, 1, 0.2, 5) * 5, 0.05, 5))
    assert ": 1 position of the board, tilted by" in str(error.value)


def test_a_frame_that_all_cameras_leave_out_is_named():
    """The board is bent in one frame far beyond its shape in the others."""
    rig = like_cameras(3, 6)
    bend = np.array([0.0, 0.0, 40.0, 0.0, 0.0, 0.0, 0.0])
    found = diagnose_views(detect(rig, boards_before(rig, 7, 0.3, 6), 0.05, 6, bend))
    assert list(found.discards.frames) == ["02"]
    assert found.discards.frames["02"].startswith("frame 02 is left out in all cameras: its board fits ")
    assert (len(found.discards.views), found.discards.all_views, found.discards.all_frames) == (3, 21, 7)
    assert found.discards.corners >= 3 * 126
    assert found.discards.describe().endswith(f"3 of 21 views, 1 of 7 frames; {found.discards.frames['02']}")


def test_pixels_that_are_not_square_are_remarked_on():
    rig = like_cameras(3, 8)
    stretched = {
        name: replace(camera, focal_px=camera.focal_px * [1.18, 1.0]) for name, camera in rig.cameras.items()
    }
    wide = replace(rig, cameras=stretched)
    found = diagnose_views(detect(wide, boards_before(wide, 8, 0.4, 8), 0.05, 8))
    assert len(found.notes) == 3
    for note, name in zip(sorted(found.notes), wide.cameras, strict=True):
        assert note.startswith(f"camera {name}: its pixels are not square, fx/fy = 1.1")
    assert found.findings == ()


@pytest.mark.parametrize("seed", list_cases([1, 3], {1}))
def test_stretched_images_of_few_views_do_not_shift_the_focal_length(seed):
    """The prior of square pixels is not for images whose pixels are far from square."""
    rig = like_cameras(2, seed)
    cameras = {
        n: replace(camera, focal_px=camera.focal_px * [1.18, 1.0]) for n, camera in rig.cameras.items()
    }
    rig = replace(rig, cameras=cameras)
    seen = detect(rig, boards_before(rig, 4, 0.2, seed), 0.2, seed)
    adjusted = adjust_bundle(solve_hierarchy(seen, BOARD, None, Silent()), BOARD).rig
    for name, camera in adjusted.cameras.items():
        np.testing.assert_allclose(camera.focal_px, cameras[name].focal_px, rtol=0.01)


@pytest.fixture(scope="module")
def sound():
    """Return the adjustment, covariance and score of a sound rig of two cameras."""
    rig = like_cameras(2, 4)
    found = solve_hierarchy(detect(rig, boards_before(rig, 5, 0.3, 4), 0.05, 4), BOARD, None, Silent())
    adjusted = adjust_bundle(found, BOARD)
    score = summarise_errors(compute_rig_errors(adjusted.rig, found.detections, BOARD, load()))
    return adjusted, compute_rig_covariance(adjusted), score


def test_residuals_of_many_pixels_are_no_rig(sound):
    adjusted, covariance, score = sound
    require_credible(adjusted, covariance, {}, score, score)
    far_off = replace(score, rms_px=40.0, median_px=9.0)
    with pytest.raises(CalibrationError, match="contradicts held-out views by 9 px in the median"):
        require_credible(adjusted, covariance, {}, far_off, score)


def test_few_positions_with_residuals_far_above_the_noise_are_no_rig(sound):
    adjusted, covariance, score = sound
    fits = {"c00": CameraFit(0.05, 0.05), "c01": CameraFit(1.6, 0.05)}
    with pytest.raises(CalibrationError, match=r"camera c01 misses its corners by 1\.6 px") as error:
        require_credible(adjusted, covariance, fits, score, score)
    assert "5 positions of the board" in str(error.value)


def test_an_impossible_focal_length_is_no_rig(sound):
    adjusted, covariance, score = sound
    name, camera = next(iter(adjusted.rig.cameras.items()))
    collapsed = {**adjusted.rig.cameras, name: replace(camera, focal_px=np.array([2.0, 2.0]))}
    rig = replace(adjusted.rig, cameras=collapsed)
    with pytest.raises(CalibrationError, match="a focal length of 2 px, which no lens"):
        require_credible(replace(adjusted, rig=rig), covariance, {}, score, score)
