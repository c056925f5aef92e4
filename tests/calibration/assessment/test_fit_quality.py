"""Assessment of a fit: errors beyond the noise are reported, noise alone is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.cross_validation import cross_validate
from beltscape.calibration.assessment.findings import list_calibration_findings
from beltscape.calibration.assessment.fit_quality import (
    CameraFit,
    FitQuality,
    assess_fit,
    compute_camera_fits,
    estimate_corner_noise_px,
)
from beltscape.calibration.assessment.score import (
    RigErrors,
    Score,
    ViewResiduals,
    compute_rig_errors,
    summarise_errors,
)
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.target.board import CharucoBoard, Chessboard, list_triples
from tests.synthetic.boards import board_poses, row_of_cameras
from tests.synthetic.detections import make_detections

BOARD = CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")


def assess_own_fit(seen: BoardDetections, core: str = "c0") -> FitQuality:
    """Return the assessment of the calibration of these corners."""
    chain = solve_hierarchy(seen, BOARD, core, Silent())
    adjusted = adjust_bundle(chain, BOARD)
    evidence = compute_rig_errors(
        adjusted.rig, chain.detections, BOARD, load(), corners_mm=adjusted.geometry.points_mm
    )
    halves, training = cross_validate(chain.detections, BOARD, core, load()), summarise_errors(evidence)
    doubts = list_calibration_findings(
        chain, compute_camera_fits(evidence, list_triples(BOARD)), halves, training
    )
    return assess_fit(halves.score if halves else training, evidence, list_triples(BOARD), doubts)


def detect_with_row(cameras: int, noise_px: float, frames: int, seed: int) -> BoardDetections:
    rig = row_of_cameras([f"c{i}" for i in range(cameras)])
    return make_detections(rig, BOARD, board_poses(BOARD, frames, seed=seed), noise_px, seed=seed)


def change_views(seen: BoardDetections, camera: str, change, frames=None) -> BoardDetections:
    """Return the detections with ``change(pixels)`` in some views of one camera, in all by default."""
    views = {name: dict(own) for name, own in seen.views.items()}
    for frame, corners in views[camera].items():
        if frames is None or frame in frames:
            views[camera][frame] = replace(corners, pixels=change(corners.pixels))
    return replace(seen, views=views)


@pytest.mark.parametrize(
    ("cameras", "noise_px", "frames", "seed"),
    [
        (2, 0.02, 8, 1),
        pytest.param(2, 0.4, 12, 2, marks=pytest.mark.thorough),
        pytest.param(3, 0.1, 6, 3, marks=pytest.mark.thorough),
        pytest.param(3, 0.3, 10, 4, marks=pytest.mark.thorough),
        pytest.param(4, 0.05, 8, 5, marks=pytest.mark.thorough),
        pytest.param(3, 0.2, 4, 6, marks=pytest.mark.thorough),
    ],
)
def test_noise_alone_gives_no_finding(cameras, noise_px, frames, seed):
    fit = assess_own_fit(detect_with_row(cameras, noise_px, frames, seed))
    assert fit.findings == ()
    assert fit.is_sound
    assert fit.rms_over_median == pytest.approx(np.sqrt(2) / np.sqrt(2 * np.log(2)), rel=0.08)
    for own in fit.cameras.values():
        assert own.corner_noise_px == pytest.approx(noise_px, rel=0.25)
        assert 0.5 < own.chi2_per_dof < 1.5


def test_a_lens_that_the_model_does_not_describe_is_reported():
    def waves(pixels):
        return pixels + 1.5 * np.sin(pixels[:, ::-1] / 25)

    fit = assess_own_fit(change_views(detect_with_row(2, 0.05, 8, 7), "c1", waves))
    assert "camera c1" in fit.findings[0]
    assert "camera c0" not in fit.findings[0]
    assert "lens model" in fit.findings[0]
    assert fit.cameras["c1"].chi2_per_dof > 4 > fit.cameras["c1"].corner_noise_px


def test_cameras_of_different_instants_are_reported():
    """The board moves between the triggers, so the views of one camera are consistent only by themselves."""
    rng = np.random.default_rng(8)
    late = change_views(detect_with_row(2, 0.05, 10, 8), "c1", lambda pixels: pixels + rng.uniform(-6, 6, 2))
    fit = assess_own_fit(late)
    assert not fit.is_sound
    assert "not triggered at the same instant" in fit.findings[0]
    assert "lens model" not in " ".join(fit.findings)


def test_views_that_fit_far_worse_than_the_rest_are_reported():
    """A third of two views' corners is displaced, as by reflections or a finger, which the median does not show."""
    rng = np.random.default_rng(9)

    def disturbed(pixels):
        return pixels + np.where(rng.random((len(pixels), 1)) < 0.3, rng.normal(0, 4, pixels.shape), 0)

    fit = assess_own_fit(change_views(detect_with_row(3, 0.05, 12, 9), "c2", disturbed, frames=("03", "07")))
    assert not fit.is_sound
    assert fit.rms_over_median > 2.5
    assert 0 < fit.far_off_share < 0.1
    named = fit.findings[-1]
    assert "times the median" in named
    assert "c2 03" in named
    assert "c2 07" in named


@pytest.mark.parametrize("sigma_px", [0.01, 0.2, 3.0])
def test_corner_noise_excludes_errors_that_neighbours_share(sigma_px):
    rng = np.random.default_rng(1)
    columns, rows = 9, 6
    ids = np.arange(columns * rows)
    u, v = ids % columns, ids // columns
    views = []
    for _ in range(12):
        shared = np.stack([5 + 0.8 * u - 0.3 * v, -2 + 0.5 * u + 0.9 * v], axis=1)
        kept = rng.random(ids.size) < 0.9
        errors = (shared + rng.normal(0, sigma_px, (ids.size, 2)))[kept]
        views.append(ViewResiduals(ids[kept], np.zeros_like(errors), errors))
    assert estimate_corner_noise_px(
        views, list_triples(Chessboard(corners=(columns, rows), square_mm=1))
    ) == pytest.approx(sigma_px, rel=0.08)


def test_corner_noise_is_nan_with_too_few_neighbours():
    one = ViewResiduals(np.arange(8), np.zeros((8, 2)), np.ones((8, 2)))
    assert np.isnan(estimate_corner_noise_px([one], list_triples(Chessboard(corners=(9, 6), square_mm=1))))


def test_a_part_of_the_corners_that_fits_far_worse_is_a_finding():
    """A lens that is wrong at the edge: 0.13 px RMS, though the median corner is at the noise of 0.013 px."""
    rng = np.random.default_rng(1)
    errors = rng.normal(0, 0.013, (400, 2))
    errors[:30] += [0.45, 0.0]
    views = {"a": {"00": ViewResiduals(np.arange(400), rng.uniform(0, 400, (400, 2)), errors)}}
    rig_errors = RigErrors(views, 1, np.empty(0), np.empty(0, np.int64), np.empty(0))
    triples = np.stack([np.arange(30, 398), np.arange(31, 399), np.arange(32, 400)], axis=1)
    score = Score(1, 1, 400, 0.13, 0.06, 0.0, 0.0, 0.0)
    fit = assess_fit(score, rig_errors, triples)
    assert not fit.cameras["a"].is_pattern()
    (line,) = fit.findings
    assert line.startswith("a part of the corners fits far worse than their noise (camera a 0.12")
    assert "px RMS against 0.013 px" in line


@pytest.mark.parametrize(
    ("fit", "has_far"),
    [
        (CameraFit(0.02, 0.013, 0.127, 0.02), True),
        (CameraFit(0.02, 0.013, 0.127, 0.0005), False),  # a single corner
        (CameraFit(0.02, 0.013, 0.09, 0.02), False),
        (CameraFit(0.02, 0.04, 0.127), False),
        (CameraFit(0.2, 0.013, 0.3), False),  # a pattern, which is reported as such
    ],
)
def test_far_residuals_need_a_ratio_and_a_size(fit, has_far):
    assert fit.has_far_residuals is has_far
