"""Scores of a rig on board views: in pixels and in millimetres."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.calibration.assessment.cross_validation import cross_validate
from beltscape.calibration.assessment.score import compute_rig_errors, summarise_errors
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.kernels import load
from tests.optional import require
from tests.synthetic.detections import make_detections

NOISE_PX = 0.1


def test_the_true_rig_has_no_errors_on_exact_views(rig, board, poses):
    found = summarise_errors(compute_rig_errors(rig, make_detections(rig, board, poses), board, load()))
    assert (found.views, found.frames, found.corners) == (48, 12, 48 * 35)
    assert found.rms_px < 1e-5
    assert found.square_rms_mm < 1e-5
    assert found.planarity_rms_mm < 1e-5


def test_a_rig_that_is_one_percent_too_large_shows_on_the_squares(rig, board, poses):
    large = Rig(
        rig.core, rig.cameras,
        {name: Pose(p.rotation, 1.01 * p.translation_mm) for name, p in rig.cam_from_core.items()},
    )  # fmt: skip
    found = summarise_errors(compute_rig_errors(large, make_detections(rig, board, poses), board, load()))
    assert found.square_bias_mm == pytest.approx(0.01 * board.square_mm, rel=1e-4)
    assert found.planarity_rms_mm < 1e-4


def test_the_errors_of_the_true_rig_equal_the_noise(rig, board, poses):
    found = summarise_errors(
        compute_rig_errors(rig, make_detections(rig, board, poses, NOISE_PX), board, load())
    )
    assert found.rms_px == pytest.approx(NOISE_PX * np.sqrt(2), rel=0.05)
    assert found.median_px == pytest.approx(NOISE_PX * np.sqrt(2 * np.log(2)), rel=0.07)  # Rayleigh
    assert abs(found.square_bias_mm) < 0.03
    assert 0.05 < found.square_rms_mm < 0.5


def test_residuals_are_detected_minus_projected(rig, board, poses):
    seen = make_detections(rig, board, poses, NOISE_PX)
    evidence = compute_rig_errors(rig, seen, board, load())
    view = evidence.residuals["c"]["05"]
    np.testing.assert_array_equal(view.pixels, seen.views["c"]["05"].pixels)
    assert view.errors_px.shape == (35, 2)
    assert view.rms_px == pytest.approx(np.sqrt((view.errors_px**2).sum(axis=1).mean()))


def test_frames_that_one_camera_sees_are_not_scored(rig, board, poses):
    frames = {"a": range(12), "b": range(5), "c": (), "d": ()}
    found = summarise_errors(
        compute_rig_errors(rig, make_detections(rig, board, poses, seen_by=frames), board, load())
    )
    assert (found.frames, found.views) == (5, 10)


def test_missing_shared_frames_are_refused(rig, board, poses):
    frames = {"a": range(6), "b": range(6, 12), "c": (), "d": ()}
    with pytest.raises(CalibrationError) as error:
        compute_rig_errors(rig, make_detections(rig, board, poses, seen_by=frames), board, load())
    assert str(error.value) == (
        "no frame shows the board to two cameras of the rig; take views that they share"
    )


def test_cross_validation_scores_held_out_views(rig, board, poses):
    found = cross_validate(make_detections(rig, board, poses, NOISE_PX), board, "b", load())
    assert found is not None
    assert (found.score.frames, found.score.views) == (12, 48)  # both halves, each judged once
    assert NOISE_PX * np.sqrt(2) < found.score.rms_px < 1.2 * NOISE_PX * np.sqrt(2)
    assert 0.3 < found.split_ratio < 2.0


def test_cross_validation_of_too_few_frames_is_none(rig, board, poses):
    assert cross_validate(make_detections(rig, board, poses[:3], NOISE_PX), board, "b", load()) is None


def test_five_frames_are_held_out_one_by_one(rig, board, poses):
    """Half of them cannot determine a rig; four of five can."""
    found = require(cross_validate(make_detections(rig, board, poses[:5], NOISE_PX), board, "b", load()))
    assert found.score.frames == 5
    assert NOISE_PX * np.sqrt(2) < found.score.rms_px < 1.5 * NOISE_PX * np.sqrt(2)
    assert np.isnan(found.split_ratio)


def test_the_reference_kernels_give_the_same_score(rig, board, poses):
    seen = make_detections(rig, board, poses, NOISE_PX)
    native, reference = (
        summarise_errors(compute_rig_errors(rig, seen, board, load(name))) for name in ("native", "reference")
    )
    for key, value in native.document().items():
        assert reference.document()[key] == pytest.approx(value, rel=1e-8, abs=1e-8)
