"""The empty belt of a rig whose lenses distort: its belt.json fits this rig and no other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.core.progress import Silent
from beltscape.files.belt_json import write_belt
from beltscape.measure.belt.empty_belt import learn_belt
from beltscape.pipeline.measuring.flow_chain import read_reference
from tests.measure.flow.moving_belt import CAMERA, depth_map

LENS = replace(CAMERA, distortion=np.array([-0.12, 0.08, 5e-4, -3e-4, 0.0]))


def rig(core: Camera) -> Rig:
    return Rig(core.name, {core.name: core}, {core.name: Pose.identity()})


@pytest.fixture(scope="module")
def belt_json(tmp_path_factory):
    path = tmp_path_factory.mktemp("belt") / "belt.json"
    write_belt(path, learn_belt([depth_map(None, 0.0)], LENS), LENS)
    return path


def test_belt_is_accepted_with_the_distorted_rig_of_its_reconstruction(belt_json):
    ground = read_reference(belt_json, rig(LENS), 4.0, Silent())
    np.testing.assert_array_equal(ground.camera.distortion, LENS.distortion)
    half = scale_rig(rig(LENS), 0.5)
    assert read_reference(belt_json, half, 4.0, Silent()).camera.size_px == half.core_camera.size_px


@pytest.mark.parametrize(
    "core",
    [
        replace(LENS, name="cam3"),
        replace(LENS, focal_px=LENS.focal_px * 1.02),
        replace(LENS, center_px=LENS.center_px + np.array([3.0, 0.0])),
    ],
    ids=["core", "focal length", "principal point"],
)
def test_belt_of_another_rig_is_refused(belt_json, core):
    with pytest.raises(InputError, match=r"belt\.json: reconstructed with another rig"):
        read_reference(belt_json, rig(core), 4.0, Silent())
