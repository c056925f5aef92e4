"""Every public name with wrong values for each argument in turn: an error of Beltscape, or a result, nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beltscape as bs
from beltscape.core.ledger import FlowRecord
from tests.report.material import belt as make_belt

WRONG: tuple[Any, ...] = (
    *(None, True, 0, -1, 7, 2.5, float("nan"), float("inf"), "", "half", b"half", object()),
    *([], [1, 2], (800, 600), ("a", "b"), {}, {"cam0": 3}, [[1.0, 2.0], [3.0, 4.0]], Path("nowhere")),
    *(np.zeros(0), np.zeros(3), np.zeros((3, 3)), np.zeros((2, 3, 4)), np.array(["a"]), 2 * np.eye(3)),
)
CAMERA = bs.Camera("cam0", (40, 30), np.full(2, 50.0), np.array([19.5, 14.5]), np.zeros(5))
RIG = bs.Rig("cam0", {"cam0": CAMERA}, {"cam0": bs.Pose.identity()})
FLAT = np.full((30, 40), 700.0, np.float32)
ONE = np.ones((30, 40))
DEPTH = bs.DepthMap(FLAT, FLAT / 1e4, ONE.astype(np.uint8), ONE.astype(np.float32))
GREY = np.zeros((30, 40), np.uint8)
POINTS = np.zeros((5, 3), np.float32)
CLOUD = bs.PointCloud(POINTS, POINTS, np.zeros((5, 3), np.uint8), np.zeros(5, np.float32))
BELT = replace(make_belt(), belt_from_core=bs.Pose.of(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 700.0]))
DEMO = bs.demo_folder()
face: Any = bs


def make_names(folder: Path) -> Mapping[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Return every public callable with arguments that it takes, or that end in an error of Beltscape."""
    belt = {name: getattr(BELT, name) for name in type(BELT).__dataclass_fields__}
    record = dict.fromkeys(FlowRecord.__dataclass_fields__, 1.0) | {
        "frame": "0", "time_ns": 0, "strip_mm": (0.0, 1.0), "quality": "measured", "reason": "",
    }  # fmt: skip
    pose = {"rotation": np.eye(3), "translation_mm": np.zeros(3)}
    return {
        "Belt": (bs.Belt, belt),
        "BeltProfile": (
            bs.BeltProfile,
            {"y_mm": 0.0, "x_mm": np.arange(3.0), "height_mm": np.zeros(3), "area_mm2": 0.0, "coverage": 1.0},
        ),
        "Camera": (
            bs.Camera,
            {
                "name": "cam0",
                "size_px": (40, 30),
                "focal_px": np.ones(2),
                "center_px": np.ones(2),
                "distortion": np.zeros(5),
                "model": "brown",
                "valid_radius_px": None,
            },
        ),
        "DepthMap": (
            bs.DepthMap,
            {name: getattr(DEPTH, name) for name in type(DEPTH).__dataclass_fields__},
        ),
        "FlowMeter": (
            bs.FlowMeter,
            {"rig": RIG, "belt": BELT, "direction": "+y", "density_kg_m3": 1600.0, "settings": None},
        ),
        "FlowRecord": (bs.FlowRecord, record),
        "FrameSet": (
            bs.FrameSet,
            {"frame": "0", "images": {"cam0": GREY}, "time_ns": 0, "position_mm": 0.0, "exposures_us": {}},
        ),
        "HeightMap": (
            bs.HeightMap,
            {
                "height_mm": np.zeros((2, 3)),
                "sigma_mm": np.zeros((2, 3)),
                "origin_mm": (0.0, 0.0),
                "cell_mm": 1.0,
            },
        ),
        "PointCloud": (
            bs.PointCloud,
            {name: getattr(CLOUD, name) for name in type(CLOUD).__dataclass_fields__},
        ),
        "Pose": (bs.Pose, pose),
        "Pose.of": (bs.Pose.of, pose),
        "Reconstructor": (
            bs.Reconstructor,
            {"rig": RIG, "preset": "fast", "depth_range_mm": (600, 800), "threads": 1, "reporter": None},
        ),
        "Reconstructor()": (bs.Reconstructor(RIG, depth_range_mm=(600, 800)), {"images": {"cam0": GREY}}),
        "Rig": (bs.Rig, {"core": "cam0", "cameras": RIG.cameras, "cam_from_core": RIG.cam_from_core}),
        "calibrate": (
            bs.calibrate,
            {
                "capture": folder / "none",
                "board": DEMO / "board.toml",
                "core": "cam0",
                "intrinsics": None,
                "intrinsics_as": "held",
                "lens_model": "auto",
                "belt": None,
                "reporter": None,
            },
        ),
        "demo_folder": (bs.demo_folder, {}),
        "learn_belt": (bs.learn_belt, {"depths": [DEPTH], "rig": RIG}),
        "measure_features": (
            bs.measure_features,
            {"depth": DEPTH, "rig": RIG, "module": DEMO / "module.toml", "image": GREY, "plain": None},
        ),
        "measure_lumps": (bs.measure_lumps, {"depth": DEPTH, "rig": RIG, "belt": None, "oversize_mm": 50.0}),
        "measure_volume": (
            bs.measure_volume,
            {
                "depth": DEPTH,
                "belt": BELT,
                "rig": RIG,
                "across_mm": (-50, 50),
                "along_mm": (-50, 50),
                "cell_mm": 5.0,
            },
        ),
        "meter.push": (
            lambda **given: bs.FlowMeter(RIG, BELT).push(**given),
            {"depth": DEPTH, "time_ns": 0, "position_mm": 0.0},
        ),
        "point_cloud": (bs.point_cloud, {"depth": DEPTH, "rig": RIG, "image": GREY}),
        "read_belt": (bs.read_belt, {"path": folder / "belt.json"}),
        "read_capture": (
            bs.read_capture,
            {"folder": DEMO / "belt_empty", "rig": bs.read_rig(DEMO / "truth/rig.json"), "reporter": None},
        ),
        "read_depth": (bs.read_depth, {"folder": folder / "depth.tiff"}),
        "read_rig": (bs.read_rig, {"path": DEMO / "truth/rig.json"}),
        "scale_rig": (bs.scale_rig, {"rig": RIG, "factor": 0.5}),
        "write_belt": (bs.write_belt, {"belt": BELT, "path": folder / "belt.json"}),
        "write_cloud": (bs.write_cloud, {"cloud": CLOUD, "path": folder / "cloud.ply"}),
        "write_depth": (bs.write_depth, {"depth": DEPTH, "folder": folder / "000"}),
        "write_ply": (bs.write_ply, {"cloud": CLOUD, "path": folder / "cloud.ply"}),
        "write_rig": (bs.write_rig, {"rig": RIG, "path": folder / "rig.json"}),
    }


def test_every_public_name_is_tried(tmp_path: Path) -> None:
    assert set(bs.__all__) - {"BeltscapeError"} <= {name.partition("(")[0] for name in make_names(tmp_path)}


@pytest.mark.parametrize("name", sorted(make_names(Path())))
def test_wrong_values_of_each_argument_are_refused_by_an_error_of_beltscape(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    call, right = make_names(tmp_path)[name]
    for argument in right:
        for wrong in WRONG:
            try:
                call(**{**right, argument: wrong})
            except bs.BeltscapeError as error:
                assert str(error) and "\n" not in str(error)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: face.scale_rig(RIG, 0), "factor = 0: must be a finite number above 0"),
        (lambda: face.scale_rig(RIG, -1), "factor = -1: must be a finite number above 0"),
        (lambda: face.scale_rig(RIG, "half"), "factor = 'half': must be a number above 0"),
        (lambda: face.scale_rig(RIG, 1e-3), "factor = 0.001: cam0's image of 40×30 px cannot have that size"),
        (
            lambda: face.Pose(2 * np.eye(3), np.zeros(3)),
            "rotation is no rotation: its rows must be of length 1",
        ),
        (lambda: face.Pose(np.diag([1.0, 1.0, -1.0]), np.zeros(3)), "rotation is no rotation"),
        (
            lambda: face.Pose([[1, 0, 0], [0, 1, 0], [0, 0, 1]], np.zeros(3)),
            "rotation is a list: must be a NumPy",
        ),
        (lambda: face.Pose(np.eye(3), np.zeros(2)), "translation_mm has the shape (2,): must be (3,)"),
        (lambda: face.Pose.identity() @ 3, "the second pose is a int: must be a Pose"),
        (
            lambda: face.DepthMap(FLAT, FLAT[1:], ONE, ONE),
            "sigma_mm has the shape (29, 40), depth_mm (30, 40): they must be the same",
        ),
        (lambda: face.DepthMap(FLAT.tolist(), FLAT, ONE, ONE), "depth_mm is a list: must be a NumPy array"),
        (lambda: face.DepthMap(FLAT[0], FLAT, ONE, ONE), "depth_mm has the shape (40,): must be (n, n)"),
        (
            lambda: face.Rig("cam9", RIG.cameras, RIG.cam_from_core),
            "core = 'cam9': must be one of the cameras, cam0",
        ),
        (
            lambda: face.Rig("cam0", RIG.cameras, {"cam1": bs.Pose.identity()}),
            "cam_from_core has no pose of cam0",
        ),
        (lambda: face.Camera("a", (0, 3), np.ones(2), np.ones(2), np.zeros(5)), "size_px = (0, 3): must be"),
        (
            lambda: face.measure_lumps(DEPTH, RIG, oversize=60),
            "unknown key oversize; did you mean oversize_mm?",
        ),
        (
            lambda: face.measure_volume(DEPTH, BELT, RIG, along_mm=(200, -200)),
            "along_mm = (200, -200): must be",
        ),
    ],
)
def test_the_argument_and_its_value_are_named(call: Callable[[], Any], says: str) -> None:
    with pytest.raises(bs.BeltscapeError) as caught:
        call()
    assert says in str(caught.value)
