"""Arguments of the Python interface that do not fit: the error names the argument."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import beltscape as bs

face: Any = bs
"""The interface as a caller without type checking uses it."""
GREY = np.zeros((4, 4), np.uint8)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda _: face.read_rig(7), "path = 7: must be a path"),
        (lambda _: face.read_rig("nowhere/rig.json"), "nowhere/rig.json: no such file"),
        (lambda rig: face.write_rig("rig.json", rig), "rig is a str: must be a Rig, from bs.read_rig"),
        (lambda _: face.Reconstructor("rig.json"), "rig is a str: must be a Rig"),
        (lambda rig: face.Reconstructor(rig, preset="fats"), "preset = 'fats'"),
        (lambda rig: face.Reconstructor(rig, depth_range_mm=(800, 600)), "depth_range_mm = (800, 600)"),
        (lambda rig: face.Reconstructor(rig, threads=-1), "threads"),
        (lambda rig: face.Reconstructor(rig)({"cam9": GREY}), "images has cam9: the rig has cam0"),
        (lambda rig: face.Reconstructor(rig)({"cam0": GREY.astype(float)}), "images['cam0'] is float64"),
        (lambda rig: face.Reconstructor(rig)([GREY]), "images is a list"),
        (lambda rig: face.measure_volume(None, "belt.json", rig), "belt is a str: must be a Belt"),
        (lambda rig: face.FlowMeter(rig, "belt.json"), "belt is a str: must be a Belt"),
        (lambda rig: face.point_cloud(None, rig), "depth is None"),
        (lambda _: face.write_ply([], "cloud.ply"), "cloud is a list: must be a PointCloud"),
        (lambda _: face.calibrate("nowhere", board=3), "board = 3: must be a path"),
        (
            lambda _: face.calibrate("x", board="b", lens_model="fish"),
            "lens_model = 'fish': must be auto or one of",
        ),
        (lambda rig: face.learn_belt([], rig), "no frame given"),
    ],
)
def test_the_argument_is_named(call, says, rig):
    with pytest.raises(bs.BeltscapeError) as caught:
        call(rig)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_by_name_are_checked(scenes, belt, rig):
    with pytest.raises(bs.BeltscapeError, match="smallest"):
        bs.measure_lumps(scenes["belt_loaded"].depth, rig, smallest=3)  # pyrefly: ignore[unexpected-keyword]


def test_a_belt_of_another_rig_is_refused(scenes, belt, rig):
    camera = replace(rig.core_camera, focal_px=rig.core_camera.focal_px * 1.01)
    other = replace(rig, cameras={**rig.cameras, rig.core: camera})
    with pytest.raises(bs.BeltscapeError, match="belt was learned with the core camera cam0 of another rig"):
        bs.measure_volume(scenes["belt_loaded"].depth, belt, other)


def test_one_depth_map_instead_of_a_list(scenes, rig):
    with pytest.raises(bs.BeltscapeError, match=r"depths is one DepthMap: give a list"):
        bs.learn_belt(scenes["belt_empty"].depth, rig)


def test_images_of_another_size_than_the_rig_are_named_with_the_factor(rig):
    with pytest.raises(
        bs.BeltscapeError, match=r"612×512 px, but the rig's cam0 has 306×256; .*scale_rig\(rig, 2\)"
    ):
        bs.read_capture(bs.demo_folder() / "module", bs.scale_rig(rig, 0.5))


def test_a_belt_learned_from_images_of_another_size_fits(belt, rig):
    meter = bs.FlowMeter(bs.scale_rig(rig, 0.5), belt)
    assert meter.records == []
