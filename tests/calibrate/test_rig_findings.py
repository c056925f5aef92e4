"""A rig held against new views: which camera changed is named, a wrong scale is told from a moved camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibrate.assessment.rig_findings import estimate_scale_factor, list_rig_findings
from beltscape.calibrate.assessment.score import compute_rig_errors, summarise_errors
from beltscape.core.pose import Pose
from beltscape.core.rig import Rig
from beltscape.kernels import load
from beltscape.target.board import corner_points_mm
from synthetic.detections import make_detections

NOISE_PX = 0.05


@pytest.fixture(scope="module")
def fresh(rig, board, poses):
    return make_detections(rig, board, poses[:6], NOISE_PX, seed=3)


def doubts(rig: Rig, seen, board) -> list[str]:
    board_mm = corner_points_mm(board)
    return list_rig_findings(rig, seen, board, board_mm, compute_rig_errors(rig, seen, board, load()))


def displaced(rig: Rig, name: str, turn_deg: float, shift_mm: float) -> Rig:
    """The rig as it is after one camera was knocked."""
    knock = Pose.of(np.deg2rad([turn_deg, 0, 0]), [shift_mm, 0, 0])
    return replace(rig, cam_from_core={**rig.cam_from_core, name: knock @ rig.cam_from_core[name]})


def test_a_true_rig_is_not_doubted(rig, board, fresh):
    assert doubts(rig, fresh, board) == []


@pytest.mark.parametrize(
    ("name", "turn_deg", "shift_mm"), [("b", 0.1, 0), ("c", 1, 0), ("d", 0, 1.5), ("b", -0.3, 2)]
)
def test_a_knocked_camera_is_named(rig, board, fresh, name, turn_deg, shift_mm):
    (found,) = doubts(displaced(rig, name, turn_deg, shift_mm), fresh, board)
    assert f"camera {name} does not fit the others" in found


def test_with_two_cameras_both_are_in_question(rig, board, fresh):
    two = Rig("a", {n: rig.cameras[n] for n in "ab"}, {n: rig.cam_from_core[n] for n in "ab"})
    (found,) = doubts(displaced(two, "b", 0.3, 0), fresh.restrict("ab", fresh.frames), board)
    assert "each of a, b fits by itself, together they do not" in found


def test_a_lens_that_changed_is_named(rig, board, fresh):
    camera = rig.cameras["c"]
    other = replace(camera, distortion=camera.distortion + np.array([0.4, 0, 0, 0, 0]))
    (found,) = doubts(replace(rig, cameras={**rig.cameras, "c": other}), fresh, board)
    assert "camera c" in found
    assert "camera a" not in found
    assert "intrinsics do not fit these views" in found


def test_a_rig_is_held_to_what_it_once_had(rig, board, poses):
    """Residuals of 0.05 px are much for a rig that had 0.008 px, and nothing for one that had 0.1 px."""
    seen = make_detections(rig, board, poses[:6], 0.005, seed=4)
    knocked = displaced(rig, "b", 0.01, 0)
    assert doubts(knocked, seen, board) == []
    assert doubts(replace(knocked, quality={"held_out": {"rms_px": 0.1}}), seen, board) == []
    (found,) = doubts(replace(knocked, quality={"held_out": {"rms_px": 0.008}}), seen, board)
    assert "camera b does not fit the others" in found


@pytest.mark.parametrize("factor", [0.9, 0.995, 1.004, 10.0])
def test_a_wrong_square_is_measured(rig, board, fresh, factor):
    given = board.model_copy(update={"square_mm": board.square_mm / factor})
    evidence = compute_rig_errors(rig, fresh, given, load())
    assert estimate_scale_factor(given, evidence, summarise_errors(evidence)) == pytest.approx(
        factor, rel=1e-3
    )


@pytest.mark.parametrize("frames", [1, 2, 6])
def test_the_true_square_has_exactly_factor_one(rig, board, poses, frames):
    evidence = compute_rig_errors(
        rig, make_detections(rig, board, poses[:frames], 0.3, seed=frames), board, load()
    )
    assert estimate_scale_factor(board, evidence, summarise_errors(evidence)) == 1
