"""Files of the truth: reproducible and complete."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beltscape.core.geometry.pose import Pose
from beltscape.files.rig_json import read_rig
from beltscape.simulate.solids.board import make_module_solids, place_module
from beltscape.simulate.solids.fines import FinesSettings
from beltscape.simulate.solids.heap import HeapSettings, make_heap
from beltscape.simulate.truth_files import SceneDetails, write_boards, write_truth
from beltscape.target.board import Chessboard, corner_points_mm
from beltscape.target.module import Base, Cube, Cylinder, Module, Sphere
from tests.simulate.scenes import BELT, station, world

MODULE = Module(
    base=Base(size_mm=(200, 150, 10)),
    cube=(
        Cube(name="small", edge_mm=30, center_mm=(60, 40)),
        Cube(name="big", edge_mm=60, center_mm=(-50, 0)),
    ),
    sphere=(Sphere(name="ball", diameter_mm=40, center_mm=(30, -30)),),
    cylinder=(Cylinder(name="post", diameter_mm=20, height_mm=70, center_mm=(80, -50)),),
)


def test_truth_of_a_module_lists_its_quantities(tmp_path):
    pose = place_module(MODULE, 5.0, -4.0, 20.0)
    there = world(*make_module_solids(MODULE, pose))
    known = SceneDetails(BELT, module=MODULE, world_from_module=pose, along_mm=(-120, 120))
    write_truth(tmp_path, "module", there, station(), known)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "belt.json", "module_depth.npz", "module_load.npz", "module_module.json", "module_scene.json",
        "projector.json", "rig.json", "station.json",
    ]  # fmt: skip
    features = json.loads((tmp_path / "module_module.json").read_text())["features"]
    assert {(f["name"], f["quantity"]): f["true_mm"] for f in features} == {
        ("base", "length"): 200, ("base", "width"): 150, ("small", "edge"): 30, ("small", "height"): 30,
        ("big", "edge"): 60, ("big", "height"): 60, ("ball", "radius"): 20, ("post", "diameter"): 20,
        ("post", "height"): 70, ("step:big-small", "height_difference"): 30,
    }  # fmt: skip
    places = json.loads((tmp_path / "module_module.json").read_text())["places"]
    assert [round(places[name]["top_mm"]) for name in ("big", "ball", "post")] == [70, 50, 80]
    rig = read_rig(tmp_path / "rig.json")
    np.testing.assert_array_equal(
        rig.cam_from_core["cam1"].rotation, station().rig.cam_from_core["cam1"].rotation
    )
    scene = json.loads((tmp_path / "module_scene.json").read_text())
    # seen from above: base, cubes, post, and of the ball half of it and the cylinder below
    above = 200 * 150 * 10 + 30**3 + 60**3 + np.pi * 100 * 70 + 5 / 3 * np.pi * 20**3
    assert scene["volume"]["volume_mm3"] == pytest.approx(above, rel=1e-3)
    assert scene["labels"] == {
        "belt": 1,
        "floor": 3,
        "base": 10,
        "small": 11,
        "big": 12,
        "ball": 13,
        "post": 14,
    }
    assert set(scene["ceilings"]) == {"belt", "load", "belt+load"}
    depth = np.load(tmp_path / "module_depth.npz")
    assert depth["depth_mm"].dtype == np.float32
    assert {10, 11, 12, 13, 14, 1} <= set(np.unique(depth["label"]).tolist())


def test_truth_of_a_heap_is_reproducible_to_the_byte(tmp_path):
    heap = make_heap(HeapSettings(rocks=20, fines=FinesSettings(along_mm=(-100.0, 100.0))), BELT)
    for folder in ("one", "two"):
        known = SceneDetails(BELT, heap=heap, along_mm=(-20, 20))
        write_truth(tmp_path / folder, "loaded", world(*heap.solids), station(), known)
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert "loaded_rocks.npz" in names
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    rocks = np.load(tmp_path / "one/loaded_rocks.npz")
    assert rocks["center_mm"].shape == (20, 3)
    assert np.load(tmp_path / "one/loaded_depth.npz")["rock"].max() < 20


def test_board_poses_are_written_for_world_and_core(tmp_path):
    board = Chessboard(corners=(5, 4), square_mm=30)
    pose = Pose.of([0.1, 0.2, 0.3], np.zeros(3)) @ Pose(np.diag([1.0, -1, -1]), np.array([-80.0, 60, 90]))
    far = Pose(pose.rotation, pose.translation_mm + np.array([5000.0, 0, 0]))
    write_boards(tmp_path, station(), board, {"000": pose, "001": far})
    document = json.loads((tmp_path / "board_poses.json").read_text())
    assert document["frames"]["000"]["corners_in_image"] == {"cam0": 20, "cam1": 20, "cam2": 20}
    assert document["frames"]["001"]["corners_in_image"] == {"cam0": 0, "cam1": 0, "cam2": 0}
    written = document["frames"]["000"]["core_from_board"]
    corners = Pose.of(written["rotation"], written["translation_mm"]).apply(corner_points_mm(board))
    expected = station().core_from_world.apply(pose.apply(corner_points_mm(board)))
    np.testing.assert_allclose(corners, expected, atol=1e-9)
