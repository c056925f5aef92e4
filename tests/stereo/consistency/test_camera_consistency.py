"""Camera consistency check on the shipped capture: sound rigs pass, and every moved camera is isolated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.reconstructing.reconstruction import open_capture
from beltscape.stereo.consistency.check import check_consistency
from beltscape.stereo.consistency.diagnosis import list_faults
from beltscape.stereo.consistency.pose_change import apply_pose_change
from beltscape.stereo.consistency.residuals import estimate_systematic_residual
from beltscape.stereo.consistency.tolerance import compute_least_px, compute_tolerance
from beltscape.stereo.consistency.wrong_images import FittingPoints, find_exchange_among
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from tests.synthetic.demo import DEMO, TRUE_RIG
from tests.thorough import list_cases

RANGE_MM = 570.0, 750.0


def turn_camera(rig, camera, degrees=(0, 0, 0), shift_mm=(0, 0, 0)):
    return apply_pose_change(rig, camera, np.concatenate([np.deg2rad(degrees), np.array(shift_mm, float)]))


@pytest.fixture(scope="module")
def rig():
    return read_rig(TRUE_RIG)


@pytest.fixture(scope="module")
def frame(rig):
    return next(iter(open_capture(DEMO / "belt_loaded", rig, Silent())))


def depth_under(rig, frame, names=None):
    settings = MultiviewSettings.preset("fast")
    return MultiviewReconstructor(rig, RANGE_MM, settings, auxiliaries=names).reconstruct(frame, Silent())


@pytest.fixture(scope="module")
def depth(rig, frame):
    return depth_under(rig, frame)


@pytest.mark.parametrize("names", list_cases([None, ("cam1", "cam2"), ("cam3",)], [None, ("cam3",)]))
def test_sound_rig_is_sound(rig, frame, depth, names):
    consistency = check_consistency(frame, rig, depth, names)
    assert consistency.guided
    assert consistency.is_sound
    assert consistency.misfit_px == 0
    assert not list_faults(consistency, rig)
    for each in consistency.cameras:
        assert each.state == "sound"
        assert each.epipolar_px < 0.05
        assert each.agreement > 0.4


def test_sound_rig_is_sound_without_depth(rig, frame):
    consistency = check_consistency(frame, rig, None)
    assert not consistency.guided
    assert consistency.is_sound
    near, far = consistency.found_depth_range_mm
    assert 550 < near < far < 760


@pytest.mark.parametrize(
    ("camera", "degrees", "shift_mm"),
    [
        pytest.param("cam1", (0.07, 0, 0), (0, 0, 0), marks=pytest.mark.thorough),
        ("cam1", (0, 0.07, 0), (0, 0, 0)),  # along the epipolar lines: only the disparity residuals show it
        pytest.param("cam2", (0.2, -0.3, 0.2), (0, 0, 0), marks=pytest.mark.thorough),
        pytest.param("cam4", (0, 0, 0), (0.5, 0, 0), marks=pytest.mark.thorough),
        pytest.param("cam3", (0, 0, 1.0), (0, 0, 0), marks=pytest.mark.thorough),
    ],
)
def test_moved_auxiliary_is_isolated(rig, frame, camera, degrees, shift_mm):
    off = turn_camera(rig, camera, degrees, shift_mm)
    consistency = check_consistency(frame, off, depth_under(off, frame))
    assert consistency.inconsistent == (camera,)
    assert consistency.pose_change is not None
    assert consistency.pose_change.camera == camera
    assert consistency.pose_change.angle_deg == pytest.approx(float(np.linalg.norm(degrees)), abs=0.06)
    (line,) = (fault.text for fault in list_faults(consistency, off))
    assert line.startswith(f"{camera}: it is ")


def test_moved_core_is_isolated(rig, frame):
    off = turn_camera(rig, rig.core, (0.05, 0.03, 0))
    consistency = check_consistency(frame, off, depth_under(off, frame))
    assert consistency.core_moved
    assert consistency.inconsistent == rig.auxiliaries
    assert consistency.misfit_px > compute_least_px(rig)
    assert list_faults(consistency, off)[0].text.startswith("the core camera cam0 moved")


def test_two_contradicting_auxiliaries_are_both_inconsistent(rig, frame):
    off = turn_camera(rig, rig.core, (0.1, 0, 0))
    names = ("cam1", "cam2")
    consistency = check_consistency(frame, off, depth_under(off, frame, names), names)
    assert consistency.inconsistent == names
    assert consistency.misfit_px > 0.5


@pytest.mark.parametrize(
    "pair",
    list_cases(
        [("cam1", "cam3"), ("cam2", "cam1"), ("cam0", "cam2"), ("cam0", "cam4")],
        [("cam0", "cam2")],
    ),
)
def test_exchanged_cameras_are_found(rig, frame, pair):
    one, other = pair
    images = {**frame.images, one: frame.images[other], other: frame.images[one]}
    suspects = rig.auxiliaries if rig.core in pair else tuple(n for n in rig.auxiliaries if n in pair)
    exchanged = find_exchange_among(FittingPoints(replace(frame, images=images), rig), suspects)
    assert exchanged is not None
    assert set(exchanged) == set(pair)


def test_image_of_another_scene_is_unmatched(rig, frame, depth):
    images = {**frame.images, "cam2": np.ascontiguousarray(frame.images["cam2"][::-1])}
    consistency = check_consistency(replace(frame, images=images), rig, depth)
    assert consistency.find_auxiliaries("unmatched") == ("cam2",)
    assert "cam2: no correspondence found" in list_faults(consistency, rig)[0].text


def test_covariance_of_the_rig_widens_the_tolerance(rig):
    sigma = np.deg2rad(0.1)
    covariance = {"parameters": ["cam1.turn_x_rad"], "matrix": [[sigma**2]]}
    tolerance = compute_tolerance(replace(rig, covariance=covariance), 670.0)
    assert tolerance.epipolar_px["cam1"] > 2
    assert tolerance.epipolar_px["cam3"] == compute_least_px(rig)
    assert compute_tolerance(rig, 670.0).epipolar_px["cam1"] == compute_least_px(rig)


def test_image_of_another_size_is_refused_by_name(rig, frame):
    images = {**frame.images, "cam3": frame.images["cam3"][:-2]}
    with pytest.raises(InputError, match=r"image of cam3 has 612×510 px, its camera in the rig 612×512"):
        depth_under(rig, replace(frame, images=images))


def test_systematic_residual_is_estimated_among_noise_and_false_matches():
    rng = np.random.default_rng(5)
    pixels = rng.uniform(0, 600, (300, 2))
    noise = rng.normal(0, 0.2, 300)
    noise[::10] = rng.uniform(-30, 30, 30)
    random = estimate_systematic_residual(noise, pixels, (600, 600))
    assert random.excess_px == 0
    assert random.rms_px < 0.1
    systematic = estimate_systematic_residual(noise + 0.01 * (pixels[:, 0] - 300), pixels, (600, 600))
    assert systematic.rms_px == pytest.approx(0.01 * 600 / np.sqrt(12), rel=0.15)
    assert systematic.rms_px > 10 * systematic.sigma_px
    assert estimate_systematic_residual(np.full(300, np.nan), pixels, (600, 600)).points == 0
