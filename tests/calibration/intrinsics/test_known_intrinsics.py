"""Calibration with given intrinsics, which are fixed."""

from __future__ import annotations

import numpy as np

from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import score_rig_against_truth
from beltscape.kernels import load
from tests.synthetic.detections import make_detections

NOISE_PX = 0.1


def test_given_intrinsics_are_fixed_and_improve_the_rig(rig, board, poses):
    own = make_detections(rig, board, poses[:6], NOISE_PX)
    free = adjust_bundle(solve_hierarchy(own, board, rig.core, Silent()), board).rig
    held = adjust_bundle(solve_hierarchy(own, board, rig.core, Silent(), known=rig.cameras), board).rig
    for name, camera in rig.cameras.items():
        np.testing.assert_array_equal(held.cameras[name].focal_px, camera.focal_px)
        np.testing.assert_array_equal(held.cameras[name].distortion, camera.distortion)
    errors = [score_rig_against_truth(found, rig, load()).depth_rms_mm for found in (held, free)]
    assert errors[0] < errors[1]


def test_some_cameras_may_be_known_and_others_not(rig, board, poses):
    own = make_detections(rig, board, poses, NOISE_PX)
    found = adjust_bundle(
        solve_hierarchy(own, board, rig.core, Silent(), known={"b": rig.cameras["b"]}), board
    ).rig
    np.testing.assert_array_equal(found.cameras["b"].center_px, rig.cameras["b"].center_px)
    assert (found.cameras["a"].center_px != rig.cameras["a"].center_px).all()
