"""Lens models chosen by corners: few edge views, a bent board, and the second choice with the board's shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.cross_validation import cross_validate
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.board_poses import list_lens_folds
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.intrinsics.lens_choice import calibrate_with_model
from beltscape.calibration.intrinsics.lens_evidence import LensErrors, compare_errors
from beltscape.calibration.lens_review import find_changed, review_lenses
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics
from beltscape.pipeline.calibrating.solving import solve_rig
from tests.synthetic.lens_views import (
    BOARD,
    BOARD_MM,
    BROWN,
    make_rational,
    make_wide_rig,
    place_edges_together,
    place_everywhere,
    see_together,
    view_from,
)
from tests.thorough import list_cases


@pytest.mark.parametrize("seed", list_cases(list(range(20)), {5}))
def test_edge_views_that_are_all_in_one_run_of_frames_find_the_lens(seed):
    seen = view_from(make_rational(), place_edges_together(seed), seed)
    with single_thread():
        found, choice = calibrate_with_model("c", seen, BOARD_MM)
    assert found.camera.model == choice.model == "rational"
    assert found.rms_px < 1.06 * np.sqrt(2) * 0.05


@pytest.mark.parametrize("seed", list_cases(list(range(20)), {0}))
def test_a_bent_board_is_not_taken_for_a_wide_lens(seed):
    seen = view_from(BROWN, place_everywhere, seed, bend_mm=0.2)
    with single_thread():
        assert calibrate_with_model("c", seen, BOARD_MM)[0].camera.model == "brown"


def test_views_of_the_edge_are_in_every_fold():
    seen = view_from(make_rational(), place_edges_together(1), 1)
    edge = {"04", "05", "06", "07"}
    folds = list(list_lens_folds(seen, "c"))
    assert len(folds) == 6
    assert sorted(frame for _, test in folds for frame in test) == sorted(seen.views["c"])
    assert max(len(edge & set(test)) for _, test in folds) == 1


def test_a_gain_in_the_outer_ring_is_clear_and_one_of_noise_is_not():
    """The second model is right; the first one is off by 0.2 px in the outer fifth of the image only."""
    seen = view_from(make_rational(), place_everywhere, 3)
    rng = np.random.default_rng(3)
    noise = {frame: rng.normal(0, 0.05, view.pixels.shape) for frame, view in seen.views["c"].items()}
    far = {
        frame: np.linalg.norm(view.pixels - np.array([639.5, 511.5]), axis=1) > 600
        for frame, view in seen.views["c"].items()
    }
    off = {frame: noise[frame] + 0.2 * far[frame][:, None] for frame in noise}
    other = {frame: each + rng.normal(0, 0.002, each.shape) for frame, each in noise.items()}
    errors = {"brown": LensErrors(off), "rational": LensErrors(noise), "fisheye": LensErrors(other)}
    gain = compare_errors(errors, ("brown", "rational"), seen, "c")
    assert gain.is_clear
    assert gain.rings[0].first_px == pytest.approx(gain.rings[0].second_px)
    assert gain.rings[-2].first_px > 2 * gain.rings[-2].second_px
    assert not compare_errors(errors, ("rational", "brown"), seen, "c").is_clear
    assert not compare_errors(errors, ("fisheye", "rational"), seen, "c").is_clear


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [0, 2])
def test_a_bent_board_hides_wide_lenses_in_the_first_choice_only(seed):
    """Four cameras: alone, the drawing leaves 0.12 to 0.2 px; together they hold out near the noise, 0.028 px."""
    rig = make_wide_rig(seed)
    seen = see_together(rig, seed, 0.25, 32)
    first = solve_hierarchy(seen, BOARD, "c0", Silent())
    assert min(each.rms_px for each in first.monocular.values()) > 0.1
    solved = solve_rig(seen, BOARD, "c0", Silent(), KnownIntrinsics({}), "auto")
    hierarchy, adjustment = solved.hierarchy, solved.adjustment
    assert {camera.model for camera in adjustment.rig.cameras.values()} == {"rational"}
    assert find_changed(hierarchy, {each.camera: each for each in hierarchy.lens_choices}) == []
    models = dict.fromkeys(rig.cameras, "rational")
    held_out = cross_validate(seen, BOARD, "c0", load(), lens_models=models)
    assert held_out is not None
    assert held_out.score.rms_px < 0.040
    for choice in hierarchy.lens_choices:
        assert choice.held_out_px[choice.model] <= 2 * min(choice.held_out_px.values())


def test_the_second_choice_corrects_a_camera_and_leaves_stated_models():
    """Two wide cameras that were taken for fisheyes; one was asked for as such."""
    seen = see_together(make_wide_rig(2, 2), 2, 0.25, 9)
    fisheye = dict.fromkeys(seen.cameras, "fisheye")
    hierarchy = solve_hierarchy(seen, BOARD, "c0", Silent(), lens_models=fisheye)
    adjustment = adjust_bundle(hierarchy, BOARD)
    assert np.any(adjustment.shape_mm)
    assert review_lenses(hierarchy, adjustment, BOARD) == {}
    chosen = tuple(replace(each, is_requested=each.camera != "c1") for each in hierarchy.lens_choices)
    choices = review_lenses(replace(hierarchy, lens_choices=chosen), adjustment, BOARD)
    assert find_changed(hierarchy, choices) == ["c1"]
    assert choices["c1"].model == "rational"
    assert choices["c1"].held_out_px["rational"] < 0.04
