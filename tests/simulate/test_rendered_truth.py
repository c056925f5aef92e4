"""The truth compared with another simulator's, for the same module on the same belt."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.simulate.core_truth import trace_core_view
from beltscape.simulate.solids.belt import BeltSettings, make_belt_solids
from beltscape.simulate.solids.board import make_module_solids
from beltscape.simulate.truth_files import compute_true_load
from beltscape.simulate.world import Station, World
from beltscape.target.module import read_module

RENDERED = Path(__file__).parents[3] / "shared/data/rendered"
pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(not RENDERED.is_dir(), reason="the rendered captures are not beside the repository"),
]


def read(name: str):
    return json.loads((RENDERED / "truth" / name).read_text())


def station() -> Station:
    found = read("rig.json")["cameras"]["cam0"]
    matrix = np.array(found["K"])
    camera = Camera("cam0", (1224, 1024), np.diag(matrix)[:2], matrix[:2, 2], np.array(found["dist"]))
    pose = Pose(np.array(found["R"]), np.array(found["t"]))
    return Station(Rig("cam0", {"cam0": camera}, {"cam0": Pose.identity()}), pose)


def world() -> World:
    placed = read("module.json")
    lift = np.array([0, 0, 10.0])
    pose = Pose(np.array(placed["base_to_world_R"]), np.array(placed["base_to_world_t"]) + lift)
    belt = make_belt_solids(BeltSettings(fold_radius_mm=0, length_mm=2400))
    return World((*belt, *make_module_solids(read_module(RENDERED / "module.toml"), pose)), None)


def test_depth_and_labels_of_the_module_agree():
    with np.load(RENDERED / "truth/module_depth_cam0.npz") as theirs:
        depth, label = theirs["z_distorted"], theirs["label_distorted"]
    ours = trace_core_view(world(), station(), distorted=True)
    same = ours.label == label
    assert same.mean() > 0.99999
    error = np.abs(ours.depth_mm - depth)[same]
    kind = label[same]
    # theirs is rounded to 0.002 mm, and its round shapes are coarser
    assert np.quantile(error[(kind >= 1) & (kind <= 14)], 0.9999) < 0.0012
    assert np.median(error[kind >= 15]) < 0.0025


def test_modules_volume_agrees():
    theirs = read("module_volume.json")
    ours = compute_true_load(world(), tuple(theirs["x_range"]), tuple(theirs["y_range"]))
    assert ours.volume_mm3 == pytest.approx(theirs["volume_mm3"], rel=2e-4)
