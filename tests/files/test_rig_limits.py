"""Implausible rigs are refused by name; unusual ones give a warning."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.files.rig_limits import find_horizon_px, find_oddities, find_refusal, find_turning_radius_px
from tests.synthetic.demo import TRUE_RIG


def edited(tmp_path, change):
    document = json.loads(TRUE_RIG.read_text())
    change(document["cameras"])
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(document))
    return path


def scale_translations(cameras, factor):
    for camera in cameras.values():
        pose = camera["cam_from_core"]
        pose["translation_mm"] = [factor * value for value in pose["translation_mm"]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: scale_translations(c, 1e-3), "in metres; multiply its translations by 1000"),
        (lambda c: scale_translations(c, 0.004), "in metres; multiply its translations by 1000"),
        (
            lambda c: c["cam2"]["cam_from_core"].update(translation_mm=[0, 0, 0]),
            "camera cam2 stands where cam0",
        ),
        (lambda c: scale_translations(c, 1e3), "are the translations in mm"),
        (
            lambda c: c["cam3"].update(distortion=[-5, 0, 0, 0, 0]),
            "camera cam3: distortion = [-5, 0, 0, 0, 0]",
        ),
        (lambda c: c["cam1"].update(focal_px=[5, 5]), "camera cam1: focal_px = [5, 5]"),
        (lambda c: c["cam1"].update(focal_px=[580, 58000]), "camera cam1: focal_px = [580, 58000]"),
        (lambda c: c["cam4"].update(center_px=[30000, 256]), "camera cam4: center_px = [30000, 256]"),
    ],
)
def test_impossible_rig_is_refused(tmp_path, change, message):
    path = edited(tmp_path, change)
    with pytest.raises(InputError) as caught:
        read_rig(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_lens_that_turns_back_is_read_with_its_stated_domain(tmp_path):
    # 1 - 3 · 0.8 r² turns at r = 0.645, about 248 px of the image of 578 px focal length
    turning = {"distortion": [-0.8, 0, 0, 0, 0]}
    with pytest.raises(
        InputError, match=r"of model brown turns back within the image, 248 px from the principal"
    ):
        read_rig(edited(tmp_path, lambda c: c["cam3"].update(turning)))
    with pytest.raises(InputError, match=r"the farthest pixel lies at 260 px"):
        read_rig(edited(tmp_path, lambda c: c["cam3"].update(turning, valid_radius_px=260)))
    rig = read_rig(edited(tmp_path, lambda c: c["cam3"].update(turning, valid_radius_px=240)))
    (odd,) = find_oddities(rig)
    assert odd.startswith(
        "camera cam3: its lens is valid up to 240 px from the principal point, the image reaches 402 px"
    )


def test_unusual_rig_is_read_with_a_warning(tmp_path):
    small = read_rig(edited(tmp_path, lambda c: scale_translations(c, 0.02)))
    assert find_refusal(small) is None
    lines = find_oddities(small)
    assert len(lines) == len(small.auxiliaries)
    for line in lines:
        assert "unusually near; are the units mm; in metres? multiply" in line
        assert "; in centimetres? multiply its translations by 10" in line


def test_plausible_rig_is_neither_refused_nor_odd(tmp_path):
    rig = read_rig(TRUE_RIG)
    assert find_refusal(rig) is None
    assert find_oddities(rig) == []
    write_rig(tmp_path / "rig.json", rig)
    assert np.array_equal(read_rig(tmp_path / "rig.json").core_camera.focal_px, rig.core_camera.focal_px)


def test_a_lens_with_a_pole_turns_back_beyond_every_pixel():
    coefficients = np.zeros(8)
    coefficients[5] = -0.5  # 1 / (1 - r²/2): the image radius goes to infinity at √2
    camera = replace(read_rig(TRUE_RIG).core_camera, model="rational", distortion=coefficients)
    assert find_turning_radius_px(camera) > 1e6
    limited = replace(camera, valid_radius_px=400.0)
    radius = limited.valid_radius
    assert radius / (1 - radius**2 / 2) * camera.focal_px.mean() == pytest.approx(400.0)


def test_a_fisheye_whose_image_reaches_beyond_a_right_angle_needs_a_radius(tmp_path):
    """The model turns back nowhere; the picture's corners look behind the camera."""
    fisheye = Camera(
        "a", (1200, 1000), np.full(2, 430.0), np.array([604.0, 493.0]), np.array([0.02, -0.01, 0.003, -0.001]),
        "fisheye",
    )  # fmt: skip
    rig = Rig("a", {"a": fisheye}, {"a": Pose.identity()})
    write_rig(tmp_path / "rig.json", rig)
    with pytest.raises(InputError, match=r"looks 90° or more off its axis.* give valid_radius_px, below 673"):
        read_rig(tmp_path / "rig.json")
    limited = replace(fisheye, valid_radius_px=find_horizon_px(fisheye) - 1)
    write_rig(tmp_path / "rig.json", Rig("a", {"a": limited}, {"a": Pose.identity()}))
    assert read_rig(tmp_path / "rig.json").core_camera.valid_radius_px == limited.valid_radius_px
