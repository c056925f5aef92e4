"""Cause of the largest σ of depth: boards that were never there, few cameras, a lens that is known in a part only."""

from __future__ import annotations

from dataclasses import replace

import pytest

from beltscape.calibration.assessment.covariance import compute_depth_sigma, compute_rig_covariance
from beltscape.calibration.assessment.lens_domain import limit_domains
from beltscape.calibration.assessment.worst_depth import explain_worst_depth
from beltscape.core.geometry.rig import Rig
from tests.calibration.assessment.test_coverage import NAMES, confine, fit_rig, make_rig
from tests.synthetic.boards import board_poses
from tests.synthetic.detections import make_detections


@pytest.fixture(scope="module")
def seen(board):
    poses = [pose for x in (-90.0, 0.0, 120.0) for pose in board_poses(board, 9, 450.0, x_mm=x)]
    return make_detections(make_rig(), board, poses, 0.02)


def explain(found, depth_mm: float, limited: Rig | None = None) -> str | None:
    rig, matrix = limited or limit_domains(found.rig, found), compute_rig_covariance(found).matrix
    return explain_worst_depth(rig, found, matrix, compute_depth_sigma(rig, matrix, depth_mm))


def test_a_board_that_never_came_to_a_part_of_an_image_is_the_cause(seen, board):
    line = explain(fit_rig(confine(seen, {"c": 0.3}), board), 450.0)
    assert line is not None
    assert line.startswith("σ of depth at 450 mm is ")
    assert "in the median and " in line
    assert "the board never came there in the image of c, whose lens is extrapolated by " in line
    assert " right of c's image, about 450 mm away" in line
    assert "\n" not in line
    line = explain(fit_rig(confine(seen, dict.fromkeys(NAMES, 0.36)), board), 450.0)
    assert line is not None
    assert "(so too " in line


def test_few_cameras_at_the_edge_of_the_view_are_the_cause(seen, board):
    line = explain(fit_rig(seen, board), 450.0)
    assert line is not None
    assert "only a and b see it, 3 elsewhere, from directions " in line
    assert "aim another camera there" in line


def test_an_even_sigma_has_no_cause(seen, board):
    assert explain(fit_rig(seen, board), 350.0) is None


def test_a_lens_that_is_known_in_a_part_only_is_named(seen, board):
    found = fit_rig(seen, board)
    camera = replace(found.rig.cameras["c"], valid_radius_px=200.0)
    limited = replace(found.rig, cameras={**found.rig.cameras, "c": camera})
    line = explain(found, 450.0, limited)
    assert line is not None
    assert "only a and b see it" in line
    assert "for c looks there beyond the radius up to which its lens is known (200 px)" in line
    assert "of c's image, about 450 mm away" in line
