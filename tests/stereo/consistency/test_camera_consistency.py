"""Camera consistency on the shipped capture: sound rigs pass, and every camera that moved is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.reconstructing.reconstruction import open_capture
from beltscape.stereo.consistency.allowance import FLOOR_PX, allowance_of
from beltscape.stereo.consistency.check import camera_consistency
from beltscape.stereo.consistency.exchange import exchange_of_frame
from beltscape.stereo.consistency.motion import moved_rig
from beltscape.stereo.consistency.texts import doubts_of
from beltscape.stereo.consistency.trend import trend_of
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.settings import MultiviewSettings
from tests.synthetic.demo import DEMO, TRUE_RIG

RANGE_MM = 570.0, 750.0


def turned(rig, camera, degrees=(0, 0, 0), shift_mm=(0, 0, 0)):
    return moved_rig(rig, camera, np.concatenate([np.deg2rad(degrees), np.array(shift_mm, float)]))


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


@pytest.mark.parametrize("names", [None, ("cam1", "cam2"), ("cam3",)])
def test_a_sound_rig_is_not_accused(rig, frame, depth, names):
    found = camera_consistency(frame, rig, depth, names)
    assert found.guided
    assert found.is_sound
    assert found.misfit_px == 0
    assert not doubts_of(found, rig)
    for each in found.cameras:
        assert each.state == "sound"
        assert each.epipolar_px < 0.05
        assert each.agreement > 0.4


def test_a_sound_rig_is_not_accused_without_depth(rig, frame):
    found = camera_consistency(frame, rig, None)
    assert not found.guided
    assert found.is_sound
    near, far = found.depths_mm
    assert 550 < near < far < 760


@pytest.mark.parametrize(
    ("camera", "degrees", "shift_mm"),
    [
        ("cam1", (0.07, 0, 0), (0, 0, 0)),
        ("cam1", (0, 0.07, 0), (0, 0, 0)),  # along the epipolar lines: only the others' depth shows it
        ("cam2", (0.2, -0.3, 0.2), (0, 0, 0)),
        ("cam4", (0, 0, 0), (0.5, 0, 0)),
        ("cam3", (0, 0, 1.0), (0, 0, 0)),
    ],
)
def test_the_camera_that_moved_is_named(rig, frame, camera, degrees, shift_mm):
    off = turned(rig, camera, degrees, shift_mm)
    found = camera_consistency(frame, off, depth_under(off, frame))
    assert found.doubtful == (camera,)
    assert found.motion is not None
    assert found.motion.camera == camera
    assert found.motion.angle_deg == pytest.approx(float(np.linalg.norm(degrees)), abs=0.06)
    (line,) = doubts_of(found, off)
    assert line.startswith(f"{camera} is ")


def test_the_core_is_named_where_only_its_motion_explains_all(rig, frame):
    off = turned(rig, rig.core, (0.05, 0.03, 0))
    found = camera_consistency(frame, off, depth_under(off, frame))
    assert found.core_moved
    assert found.doubtful == rig.auxiliaries
    assert found.misfit_px > FLOOR_PX
    assert doubts_of(found, off)[0].startswith("the core camera cam0 moved")


def test_two_auxiliaries_that_contradict_each_other_are_both_in_doubt(rig, frame):
    off = turned(rig, rig.core, (0.1, 0, 0))
    names = ("cam1", "cam2")
    found = camera_consistency(frame, off, depth_under(off, frame, names), names)
    assert found.doubtful == names
    assert found.misfit_px > 0.5


@pytest.mark.parametrize("pair", [("cam1", "cam3"), ("cam2", "cam1"), ("cam0", "cam4")])
def test_exchanged_cameras_are_named(rig, frame, pair):
    one, other = pair
    images = {**frame.images, one: frame.images[other], other: frame.images[one]}
    doubtful = rig.auxiliaries if rig.core in pair else tuple(n for n in rig.auxiliaries if n in pair)
    found = exchange_of_frame(replace(frame, images=images), rig, doubtful)
    assert found is not None
    assert set(found) == set(pair)


def test_an_image_of_something_else_is_unmatched(rig, frame, depth):
    images = {**frame.images, "cam2": np.ascontiguousarray(frame.images["cam2"][::-1])}
    found = camera_consistency(replace(frame, images=images), rig, depth)
    assert found.named("unmatched") == ("cam2",)
    assert "cam2: no correspondence found" in doubts_of(found, rig)[0]


def test_a_rigs_covariance_widens_what_it_allows(rig):
    sigma = np.deg2rad(0.1)
    covariance = {"parameters": ["cam1.turn_x_rad"], "matrix": [[sigma**2]]}
    allowed = allowance_of(replace(rig, covariance=covariance), 670.0)
    assert allowed.across_px["cam1"] > 2
    assert allowed.across_px["cam3"] == FLOOR_PX
    assert allowance_of(rig, 670.0).across_px["cam1"] == FLOOR_PX


def test_an_image_of_another_size_is_refused_by_name(rig, frame):
    images = {**frame.images, "cam3": frame.images["cam3"][:-2]}
    with pytest.raises(InputError, match=r"image of cam3 has 612×510 px, its camera in the rig 612×512"):
        depth_under(rig, replace(frame, images=images))


def test_a_trend_is_what_residuals_have_in_common():
    rng = np.random.default_rng(5)
    place = rng.uniform(0, 600, (300, 2))
    noise = rng.normal(0, 0.2, 300)
    noise[::10] = rng.uniform(-30, 30, 30)
    still = trend_of(noise, place, (600, 600))
    assert still.excess_px == 0
    assert still.rms_px < 0.1
    rolled = trend_of(noise + 0.01 * (place[:, 0] - 300), place, (600, 600))
    assert rolled.rms_px == pytest.approx(0.01 * 600 / np.sqrt(12), rel=0.15)
    assert rolled.rms_px > 10 * rolled.sigma_px
    assert trend_of(np.full(300, np.nan), place, (600, 600)).points == 0
