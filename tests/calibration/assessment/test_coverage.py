"""Coverage of the measuring volume: gaps are found by the σ that they cause, and the truth confirms this σ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.coverage import (
    Coverage,
    MeasuringVolume,
    UncoveredVolumeError,
    assess_coverage,
    describe_gap,
    describe_tolerance,
    list_coverage_findings,
    make_view_volume,
    require_coverage,
)
from beltscape.calibration.assessment.covered_volume import limit_to_coverage
from beltscape.calibration.assessment.lens_domain import limit_domains
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult, adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.report.calibration_plots import coverage_picture
from tests.optional import require
from tests.synthetic.boards import board_poses, row_of_cameras
from tests.synthetic.detections import make_detections
from tests.thorough import list_cases

WIDE = [0.9, 0.2, 3e-4, -2e-4, 0.01, 1.25, 0.45, 0.05]
"""A rational lens, which a polynomial describes within its corners only."""
NAMES = ["a", "b", "c"]


def make_rig(model: str = "brown") -> Rig:
    rig = row_of_cameras(NAMES, 90.0, 500.0)
    if model == "brown":
        return rig
    lens = {"rational": WIDE, "fisheye": [0.02, -0.01, 0.003, -0.001]}[model]
    cameras = {
        name: replace(camera, model=model, distortion=np.array(lens), focal_px=np.full(2, 280.0))
        for name, camera in rig.cameras.items()
    }
    return replace(rig, cameras=cameras)


def confine(seen: BoardDetections, share: Mapping[str, float]) -> BoardDetections:
    """Return the corners within the middle share of each camera's image."""
    views = {name: dict(own) for name, own in seen.views.items()}
    for name, part in share.items():
        size = np.array(seen.sizes_px[name])
        for frame, corners in seen.views[name].items():
            off = np.abs(corners.pixels / size - 0.5).max(axis=1)
            kept = corners.select(off < part / 2)
            views[name][frame] = kept
            if len(kept) < 12:
                del views[name][frame]
    return replace(seen, views=views)


def fit_rig(seen, board, models="brown") -> BundleAdjustmentResult:
    lenses = dict.fromkeys(NAMES, models)
    return adjust_bundle(solve_hierarchy(seen, board, "a", Silent(), lens_models=lenses), board)


def cover(found: BundleAdjustmentResult, volume: MeasuringVolume | None = None) -> Coverage:
    limited = limit_domains(found.rig, found)
    return assess_coverage(found, limited, 1.0, volume or make_view_volume(limited, found.geometry))


@pytest.fixture(scope="module")
def seen(board):
    poses = [pose for x in (-90.0, 0.0, 120.0) for pose in board_poses(board, 9, 450.0, x_mm=x)]
    return make_detections(make_rig(), board, poses, 0.02)


def belt_ahead(width_mm: float, depth_mm: float = 450.0) -> MeasuringVolume:
    side = np.linspace(-width_mm / 2, width_mm / 2, 21)
    x, y = np.meshgrid(side, side)
    return MeasuringVolume(
        "the belt", np.stack([x, y, np.full_like(x, depth_mm)], axis=-1).reshape(-1, 3), is_given=True
    )


def test_boards_that_fill_the_images_leave_no_gap(seen, board):
    coverage = cover(fit_rig(seen, board))
    require_coverage(coverage)
    assert list_coverage_findings(coverage) == []
    assert np.nanmax(coverage.sigma_px[coverage.is_needed]) < 0.1


def test_boards_in_the_middle_of_the_images_are_refused(seen, board):
    coverage = cover(fit_rig(confine(seen, dict.fromkeys(NAMES, 0.36)), board))
    with pytest.raises(UncoveredVolumeError) as error:
        require_coverage(coverage)
    line = str(error.value)
    assert "the board never came to" in line
    assert "the whole view of a" in line
    assert "photograph the board at all edges and corners" in line
    assert "\n" not in line
    assert coverage_picture(error.value.coverage).startswith(b"\x89PNG")


def test_a_rig_without_a_belt_is_limited_to_what_the_boards_covered(seen, board):
    """Within its limits the true depths are found; beyond them no camera is used."""
    true, found = make_rig(), fit_rig(confine(seen, dict.fromkeys(NAMES, 0.36)), board)
    limited = limit_domains(found.rig, found)
    covered = limit_to_coverage(found, limited, 1.0, cover(found))
    assert "a" in covered.limits_px
    assert len(covered.limits_px) >= 2
    assert 0.1 < covered.share < 0.6
    require_coverage(covered.coverage)
    for name in covered.limits_px:
        camera = covered.rig.cameras[name]
        radius = require(camera.valid_radius_px)
        corners = covered.coverage.cameras[name].corners_px
        reach = np.linalg.norm(corners - camera.center_px, axis=1).max()
        assert 0.5 * reach < radius < 0.35 * np.hypot(*camera.size_px)
        assert np.isnan(camera.undistort(camera.center_px + np.array([[radius + 3, 0.0]]))).all()
    error_mm = measure_depth_error(true, covered.rig, covered.coverage.volume.points_mm)
    assert np.isfinite(error_mm).sum() > 50
    assert np.nanquantile(error_mm, 0.9) < 1.5
    assert "limited to the" in covered.describe()
    assert "--belt" in covered.describe()


def test_a_camera_with_a_gap_is_limited_and_the_others_are_not(seen, board):
    found = fit_rig(confine(seen, {"c": 0.3}), board)
    coverage = cover(found)
    covered = limit_to_coverage(found, limit_domains(found.rig, found), 1.0, coverage)
    assert set(covered.limits_px) == {"c"}
    assert covered.share > 0.9
    assert covered.coverage.share(covered.coverage.is_unusable) < 0.02


def test_a_rig_of_which_nothing_remains_is_withheld_and_the_option_named(seen, board):
    """As if the boards had been in a corner of every image: no circle around the middle is covered."""
    found = fit_rig(confine(seen, dict.fromkeys(NAMES, 0.36)), board)
    coverage = cover(found)
    nowhere = {
        name: replace(own, is_reached=np.zeros_like(own.is_reached)) for name, own in coverage.cameras.items()
    }
    lost = replace(coverage, cameras=nowhere, is_unusable=np.ones_like(coverage.is_unusable))
    with pytest.raises(UncoveredVolumeError, match=r"of a's image, about .*, or name the belt with --belt"):
        limit_to_coverage(found, limit_domains(found.rig, found), 1.0, lost)


@pytest.mark.parametrize(("tolerance_mm", "verdict"), [(10.0, "passes: "), (0.001, "fails: ")])
def test_sigma_over_a_planned_belt_is_compared_with_its_tolerance(seen, board, tolerance_mm, verdict):
    found = fit_rig(seen, board)
    line = require(describe_tolerance(cover(found, replace(belt_ahead(150.0), tolerance_mm=tolerance_mm))))
    assert line.startswith(verdict)
    assert f"which assumes {tolerance_mm:g} mm (calibration_sigma_mm)" in line
    assert describe_tolerance(cover(found, belt_ahead(150.0))) is None


def test_an_absurd_sigma_is_not_stated(seen, board):
    coverage = cover(fit_rig(confine(seen, dict.fromkeys(NAMES, 0.36)), board))
    for sigma_px, line in ((300.0, "depth not measurable"), (2.0, "uncertain by up to")):
        stated = replace(coverage, sigma_px=np.where(coverage.is_unusable, sigma_px, 0.01))
        assert line in describe_gap(stated, coverage.is_unusable)


def test_a_belt_that_lies_where_the_boards_were_is_accepted(seen, board):
    found = fit_rig(confine(seen, dict.fromkeys(NAMES, 0.6)), board)
    small, large = cover(found, belt_ahead(150.0)), cover(found, belt_ahead(800.0))
    require_coverage(small)
    assert list_coverage_findings(small) == []
    assert large.share(large.is_uncertain) > 0.02
    assert list_coverage_findings(large)


def test_the_auxiliary_with_the_gap_is_named(seen, board):
    coverage = cover(fit_rig(confine(seen, {"c": 0.4}), board))
    gap = coverage.is_uncertain
    assert gap.any()
    line = (list_coverage_findings(coverage) or [""])[0]
    assert line.startswith("camera c: ")
    assert "so too" not in line


@pytest.mark.parametrize("share", list_cases([0.4, 0.5], {0.5}))
def test_sigma_of_a_gap_covers_the_error_of_an_extrapolated_polynomial(board, share: float):
    """The true lenses are rational; Brown's polynomial fits their corners to the noise, and errs beyond them."""
    true = make_rig("rational")
    poses = [pose for x in (-90.0, 0.0, 120.0) for pose in board_poses(board, 9, 450.0, x_mm=x)]
    seen = confine(make_detections(true, board, poses, 0.02), dict.fromkeys(NAMES, share))
    found = fit_rig(seen, board)
    np.testing.assert_allclose(found.sigma_px, 0.02, rtol=0.1)
    coverage = cover(found)
    error_mm = measure_depth_error(true, found.rig, coverage.volume.points_mm)
    gap = coverage.is_unusable & np.isfinite(error_mm)
    assert gap.sum() > 100
    assert np.median(error_mm[gap]) > 5
    assert np.median(error_mm[gap] / coverage.sigma_mm[gap]) < 3


def measure_depth_error(true: Rig, found: Rig, points: np.ndarray) -> np.ndarray:
    """Return the error (N,) of depths that a found rig triangulates from pixels of the true one."""
    ideal = []
    for name, camera in found.cameras.items():
        pixels = true.cameras[name].project(true.cam_from_core[name].apply(points))
        ideal.append(camera.undistort(pixels) * camera.focal_px + camera.center_px)
    projections = np.stack([found.projection(name) for name in found.cameras])
    return np.abs(load().triangulate(projections, np.stack(ideal), threads=1)[:, 2] - points[:, 2])


def test_a_belt_beyond_the_domain_of_wide_lenses_is_refused(board):
    true = make_rig("fisheye")
    seen = make_detections(true, board, board_poses(board, 12, 500.0), 0.02)
    found = fit_rig(confine(seen, dict.fromkeys(NAMES, 0.6)), board, "fisheye")
    require_coverage(cover(found))  # an image need not be used whole
    with pytest.raises(UncoveredVolumeError, match="its lens is not known and nothing is measured"):
        require_coverage(cover(found, belt_ahead(900.0)))
    require_coverage(cover(found, belt_ahead(150.0)))
