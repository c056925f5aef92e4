"""Verdict on rigs that are wrong in one quantity, and on images of other instants, under sparse, alike dots."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.progress import Silent
from beltscape.pipeline.reconstructing.camera_checks import CameraCheck
from beltscape.stereo.consistency.check import check_consistency
from beltscape.stereo.consistency.diagnosis import (
    add_instant,
    describe_undecided,
    diagnose_cameras,
    find_causes,
    list_faults,
)
from beltscape.stereo.consistency.rig_consistency import NO_FIT, fit_rows
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from stereo_pairs.read_pairs import read_dice_auto, read_motorcycle
from tests.synthetic.dotted_room import Arrangement, compute_room_depth, falsify, make_room_rig, render_room
from tests.thorough import list_cases, list_rows

WIDTH_PX = 760
RANGE_MM = 1150.0, 2600.0
OTHER_PLACE_MM = -420.0
"""Displacement of the cupboards between two instants."""


@cache
def render_once(auxiliaries: int, arrangement: Arrangement, shift_mm: float):
    rig = make_room_rig(auxiliaries, width_px=WIDTH_PX)
    return render_room(rig, arrangement, shifts_mm=dict.fromkeys(rig.cameras, shift_mm))


def see(auxiliaries, arrangement: Arrangement = "jittered", shift_mm: float = 0.0):
    """Return a rig and its frame; fewer cameras see the same images."""
    rig = make_room_rig(auxiliaries, width_px=WIDTH_PX)
    frame = render_once(max(auxiliaries, 2), arrangement, shift_mm)
    return rig, replace(frame, images={name: frame.images[name] for name in rig.cameras})


def see_with_late(auxiliaries, *late):
    """Return the rig, a frame whose late cameras show the instant before, and the frame set of that instant."""
    rig, now = see(auxiliaries)
    _, before = see(auxiliaries, shift_mm=OTHER_PLACE_MM)
    return rig, replace(now, images={**now.images, **{name: before.images[name] for name in late}}), before


@pytest.mark.parametrize("auxiliaries", list_cases([1, 2, 4], [2]))
def test_sound_rigs_are_sound(auxiliaries):
    rig, frame = see(auxiliaries)
    consistency = check_consistency(frame, rig, None)
    assert len(consistency.find_auxiliaries("sound")) == auxiliaries
    assert not diagnose_cameras(frame, rig, consistency)
    assert all(each.rows.rms_px < 0.1 for each in consistency.cameras)


ERRORS = [
    (auxiliaries, *error)
    for auxiliaries in (1, 2)
    for error in (
        ("focal_y", -0.012, "focal_px[1] is 1.01"),
        ("focal_y", 0.03, "focal_px[1] is 0.97"),
        ("center_y", 5.0, "center_px[1] is -5.0 px"),
        ("center_y", -14.0, "center_px[1] is +14.0 px"),
        ("scale", 0.012, "image scale is 0.988"),
        ("roll", 0.6, "turned by -0.60° about its optical axis"),
        ("pitch", -0.4, "turned by +0.40° about its x axis"),
        ("baseline_side", 12.0, "of its baseline to the side"),
    )
]
FEW = [ERRORS[i] for i in (0, 10, 4, 13)]
"""A wrong lens and a wrong pose, with either number of auxiliaries."""


@pytest.mark.parametrize(("auxiliaries", "error", "size", "named"), list_rows(ERRORS, FEW))
def test_error_across_the_rows_is_named_with_its_size(auxiliaries, error, size, named):
    rig, frame = see(auxiliaries)
    off = falsify(rig, error, size)
    consistency = check_consistency(frame, off, None)
    assert consistency.inconsistent == ("right",)
    (fault,) = diagnose_cameras(frame, off, consistency)
    assert fault.cameras == (("right",) if auxiliaries > 1 else ())
    assert ("right: it is " if auxiliaries > 1 else "right is ") in fault.text
    assert named in fault.text


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("error", "size", "named"),
    [
        ("focal_y", 0.012, "focal_px[1] is 0.98"),
        ("center_y", 6.0, "center_px[1] is -6.0"),
        ("roll", 0.6, "turned by -0.60°"),
        ("scale", 0.02, "image scale is 0.98"),
    ],
)
def test_one_wrong_camera_of_five_is_named_alone(error, size, named):
    rig, frame = see(4)
    off = falsify(rig, error, size)
    consistency = check_consistency(frame, off, None)
    assert consistency.inconsistent == ("right",)
    (fault,) = diagnose_cameras(frame, off, consistency)
    assert fault.cameras == ("right",)
    assert named in fault.text


@pytest.mark.parametrize(
    ("error", "size"),
    list_rows([("focal_x", 0.02), ("baseline_length", 0.04), ("center_x", 8.0)], [("focal_x", 0.02)]),
)
def test_error_along_the_rows_shows_between_auxiliaries_only(error, size):
    rig, frame = see(1)
    assert check_consistency(frame, falsify(rig, error, size), None).is_sound
    rig, frame = see(2)
    consistency = check_consistency(frame, falsify(rig, error, size), None)
    assert "right" in consistency.inconsistent
    assert max(each.disparity_px for each in consistency.cameras) > 1


def test_row_error_is_a_function_of_place():
    rig, frame = see(1)
    (camera,) = check_consistency(frame, falsify(rig, "focal_y", -0.012), None).cameras
    half_height = rig.core_camera.size_px[1] / 2
    assert abs(camera.rows.slope_y_px) == pytest.approx(0.012 * half_height, rel=0.1)
    assert abs(camera.rows.offset_px) < 0.2
    assert abs(camera.rows.slope_x_px) < 0.2
    assert camera.rows.explained > 0.95 * camera.points


@pytest.mark.parametrize("arrangement", ["jittered", pytest.param("random", marks=pytest.mark.thorough)])
def test_depth_map_of_chance_matches_makes_no_wrong_rig_sound(arrangement):
    rig, frame = see(1, arrangement)
    off = falsify(rig, "focal_y", -0.014)

    def check(stated):
        settings = MultiviewSettings.preset("fast")
        depth = MultiviewReconstructor(stated, RANGE_MM, settings).reconstruct(frame, Silent())
        return check_consistency(frame, stated, depth)

    sound = check(rig)
    assert sound.guided
    assert sound.is_confirmed
    wrong = check(off)
    assert wrong.inconsistent == ("right",)
    assert not wrong.guided


def make_true_depth(rig):
    depth = compute_room_depth(rig).astype(np.float32)
    views, whole = np.ones(depth.shape, np.uint8), np.ones_like(depth)
    return DepthMap(depth, np.full_like(depth, 0.5), views, whole)


def test_half_a_pixel_contradicts_only_a_rig_that_claims_to_be_better_known():
    rig, frame = see(1)
    off = falsify(rig, "center_y", 0.5)
    loose = check_consistency(frame, off, make_true_depth(off))
    assert loose.is_sound
    assert loose.cameras[0].epipolar_px == pytest.approx(0.5, abs=0.05)
    assert loose.cameras[0].tolerance_px > 0.5
    assert loose.misfit_px > 0.4, "σ of the depth includes it"
    stated = replace(off, covariance={"parameters": ["right.cy_px"], "matrix": [[0.02**2]]})
    assert check_consistency(frame, stated, make_true_depth(off)).inconsistent == ("right",)


def test_points_that_fail_outnumbering_those_that_agree_are_undecided():
    rig, frame = see(1)
    depth, other = make_true_depth(rig), frame.images["right"][::-1]
    edge = 11 * WIDTH_PX // 20
    depth.depth_mm[:, :edge] = np.nan  # nothing was measured
    sound = check_consistency(frame, rig, depth)
    assert sound.find_auxiliaries("sound") == ("right",), "the points there are found without a depth"
    images = {**frame.images, "right": np.where(np.arange(WIDTH_PX) < edge, other, frame.images["right"])}
    consistency = check_consistency(replace(frame, images=images), rig, depth)
    assert consistency.find_auxiliaries("undecided") == ("right",)
    assert consistency.cameras[0].failing > 60
    assert not consistency.inconsistent
    (line,) = describe_undecided(consistency, rig)
    assert "synchronisation" in line


@pytest.mark.thorough
def test_core_of_another_instant_is_named():
    rig, frame, _ = see_with_late(2, "left")
    consistency = check_consistency(frame, rig, None)
    (fault,) = diagnose_cameras(frame, rig, consistency)
    assert fault.cameras == ("left",)
    assert fault.is_of_instant
    assert "synchronisation" in fault.text


@pytest.mark.parametrize(
    ("auxiliaries", "camera"),
    list_rows([(2, "left"), (2, "right"), (1, "left"), (1, "right")], [(2, "left"), (2, "right")]),
)
def test_frame_before_shows_which_camera_is_late(auxiliaries, camera):
    rig, frame, before = see_with_late(auxiliaries, camera)
    consistency = check_consistency(frame, rig, None)
    causes = add_instant(find_causes(frame, rig, consistency), frame, rig, consistency, before)
    assert causes.instant is not None
    if auxiliaries > 1:
        assert (causes.instant.camera, causes.instant.frames) == (camera, 1)
    (fault,) = list_faults(consistency, rig, causes)
    assert "one frame" in fault.text


@pytest.mark.thorough
def test_late_core_is_held_until_moving_load_shows_its_own_instant():
    rig, late, before = see_with_late(2, "left")
    _, now = see(2)
    check = CameraCheck(rig, RANGE_MM)

    def diagnose(frame_set):
        check.note_frame(frame_set)
        return check.diagnose(frame_set, check.check(frame_set, None, rig.auxiliaries))

    assert not diagnose(before)
    (fault,) = diagnose(late)
    assert fault.cameras == ("left",)
    assert fault.is_of_instant
    assert fault.concerns_core
    check.note_frame(now)
    (held,) = diagnose(now)  # nothing moved since: any instant looks the same
    assert held.is_of_instant
    assert not held.concerns_core
    assert not diagnose(before)


def test_auxiliary_of_another_instant_is_named_with_synchronisation_first():
    rig, frame, _ = see_with_late(2, "right")
    consistency = check_consistency(frame, rig, None)
    (fault,) = diagnose_cameras(frame, rig, consistency)
    assert fault.cameras == ("right",)
    assert fault.text.index("synchronisation") < fault.text.index("moved")


@pytest.mark.parametrize("false", [0.0, 0.4])
def test_fit_finds_the_rows_among_false_matches(false):
    rng = np.random.default_rng(3)
    pixels = rng.uniform(0, 1000, (150, 2))
    depth = rng.uniform(4e-4, 8e-4, 150)
    rows = 5.0 - 0.012 * pixels[:, 1] + rng.normal(0, 0.1, 150)
    wrong = rng.random(150) < false
    rows[wrong] = rng.uniform(-30, 30, int(wrong.sum()))
    fit = fit_rows(rows, pixels, depth, (1000, 1000))
    assert fit.offset_px == pytest.approx(-1.0, abs=0.1)
    assert fit.slope_y_px == pytest.approx(-6.0, abs=0.15)
    assert fit.explained == pytest.approx(int((~wrong).sum()), abs=8)
    assert fit_rows(rows[:5], pixels[:5], depth[:5], (1000, 1000)) == NO_FIT


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("dice_stereo_auto", read_dice_auto),
        ("middlebury_motorcycle", read_motorcycle),
    ],
)
def test_real_pairs_are_sound_and_named_with_a_wrong_focal_length(real_data, name, read):
    pair = read(real_data(name))
    assert check_consistency(pair.frame_set, pair.rig, None).is_sound
    (auxiliary,) = pair.rig.auxiliaries
    off = falsify(pair.rig, "focal_y", -0.01, auxiliary)
    consistency = check_consistency(pair.frame_set, off, None)
    assert consistency.inconsistent == (auxiliary,)
    (fault,) = diagnose_cameras(pair.frame_set, off, consistency)
    assert "focal_px[1] is 1.01" in fault.text
