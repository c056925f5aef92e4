"""Findings of a rig on new views: changed cameras are isolated and distinguished from a wrong scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.findings import estimate_scale_factor, list_rig_findings
from beltscape.calibration.assessment.score import compute_rig_errors, summarise_errors
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.kernels import load
from beltscape.target.board import corner_points_mm
from tests.synthetic.detections import make_detections
from tests.thorough import list_cases

NOISE_PX = 0.05


@pytest.fixture(scope="module")
def fresh(rig, board, poses):
    return make_detections(rig, board, poses[:6], NOISE_PX, seed=3)


def list_findings(rig: Rig, seen, board) -> list[str]:
    board_mm = corner_points_mm(board)
    return list_rig_findings(rig, seen, board, board_mm, compute_rig_errors(rig, seen, board, load()))


def displace_camera(rig: Rig, name: str, turn_deg: float, shift_mm: float) -> Rig:
    """Return the rig with one camera displaced."""
    knock = Pose.of(np.deg2rad([turn_deg, 0, 0]), [shift_mm, 0, 0])
    return replace(rig, cam_from_core={**rig.cam_from_core, name: knock @ rig.cam_from_core[name]})


def test_a_true_rig_has_no_findings(rig, board, fresh):
    assert list_findings(rig, fresh, board) == []


@pytest.mark.parametrize(
    ("name", "turn_deg", "shift_mm"),
    [
        ("b", 0.1, 0),
        pytest.param("c", 1, 0, marks=pytest.mark.thorough),
        ("d", 0, 1.5),
        pytest.param("b", -0.3, 2, marks=pytest.mark.thorough),
    ],
)
def test_a_displaced_camera_is_reported(rig, board, fresh, name, turn_deg, shift_mm):
    (found,) = list_findings(displace_camera(rig, name, turn_deg, shift_mm), fresh, board)
    assert f"camera {name} does not fit the others" in found


def test_with_two_cameras_the_displaced_one_is_not_isolated(rig, board, fresh):
    two = Rig("a", {n: rig.cameras[n] for n in "ab"}, {n: rig.cam_from_core[n] for n in "ab"})
    (found,) = list_findings(displace_camera(two, "b", 0.3, 0), fresh.restrict("ab", fresh.frames), board)
    assert "each of a, b fits by itself, together they do not" in found


def test_a_changed_lens_is_reported(rig, board, fresh):
    camera = rig.cameras["c"]
    other = replace(camera, distortion=camera.distortion + np.array([0.4, 0, 0, 0, 0]))
    (found,) = list_findings(replace(rig, cameras={**rig.cameras, "c": other}), fresh, board)
    assert "camera c" in found
    assert "camera a" not in found
    assert "intrinsics do not fit these views" in found


def test_the_limit_follows_the_rigs_held_out_residuals(rig, board, poses):
    """Residuals of 0.05 px exceed the limit of a rig that had 0.008 px, not of one that had 0.1 px."""
    seen = make_detections(rig, board, poses[:6], 0.005, seed=4)
    knocked = displace_camera(rig, "b", 0.01, 0)
    assert list_findings(knocked, seen, board) == []
    assert list_findings(replace(knocked, quality={"held_out": {"rms_px": 0.1}}), seen, board) == []
    (found,) = list_findings(replace(knocked, quality={"held_out": {"rms_px": 0.008}}), seen, board)
    assert "camera b does not fit the others" in found


@pytest.mark.parametrize("factor", list_cases([0.9, 0.995, 1.004, 10.0], {0.995, 10.0}))
def test_a_wrong_square_size_is_measured(rig, board, fresh, factor):
    given = board.model_copy(update={"square_mm": board.square_mm / factor})
    evidence = compute_rig_errors(rig, fresh, given, load())
    assert estimate_scale_factor(given, evidence, summarise_errors(evidence)) == pytest.approx(
        factor, rel=1e-3
    )


@pytest.mark.parametrize("frames", list_cases([1, 2, 6], {1}))
def test_the_true_square_has_exactly_factor_one(rig, board, poses, frames):
    evidence = compute_rig_errors(
        rig, make_detections(rig, board, poses[:frames], 0.3, seed=frames), board, load()
    )
    assert estimate_scale_factor(board, evidence, summarise_errors(evidence)) == 1
