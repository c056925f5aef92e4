"""Simulated captures: their files, and the agreement of images and truth."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from beltscape.calibration.detection.detector import DEFAULT_VARIANT, make_detector
from beltscape.core.errors import InputError, SettingsError
from beltscape.core.geometry.pose import Pose
from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.files.images import read_image
from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig
from beltscape.files.tiff import read_float_tiff
from beltscape.pipeline.simulation import simulate
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.target.board import CharucoBoard, corner_points_mm, read_board
from beltscape.target.module import read_module
from tests.simulate.tiny import CUBES, tiny
from tests.thorough import THOROUGH, list_cases

CAMERAS = ("cam0", "cam1", "cam2")
TOF = {"camera": {"size_px": (64, 48), "multipath": False}}
MOTION = {"speed_mm_s": 500.0, "frames_per_s": 5.0, "start_mm": -100.0, "encoder_scale": 1.02}
SMALL = {"size_px": (172, 142), "pitch_um": 49.1}
SCENES = {
    "calibration": partial(tiny, "calibration", frames=2, rig=SMALL),
    "module": partial(tiny, "module", speckle=False, rig=SMALL, module=CUBES),
    "belt_empty": partial(tiny, "belt_empty", frames=2, rig=SMALL),
    "belt_loaded": partial(tiny, "belt_loaded", tof=TOF, rig=SMALL),
    "belt_moving": partial(tiny, "belt_moving", frames=3, speckle=False, motion=MOTION),
}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A function kind → the folder of its capture, each rendered once; nobody writes into it."""
    folders: dict[str, Path] = {}

    def capture(kind: str) -> Path:
        if kind not in folders:
            folders[kind] = tmp_path_factory.mktemp(kind)
            simulate(SCENES[kind](), folders[kind], Silent())
        return folders[kind]

    return capture


@pytest.mark.parametrize("kind", list_cases(SCENES, ["calibration", "belt_moving"]))
def test_simulated_capture_reads_as_a_capture(simulated, kind):
    scene, folder = SCENES[kind](), simulated(kind)
    capture = read_capture(folder)
    assert capture.cameras == CAMERAS  # neither truth nor tof
    assert capture.frames == tuple(f"{i:03d}" for i in range(scene.frames or 1))
    assert capture.describe_omissions() == []
    rig = read_rig(folder / "truth" / "rig.json")
    for name in CAMERAS:
        image = read_image(capture.files[name]["000"])
        assert image.shape[1::-1] == rig.cameras[name].size_px
        assert image.std() > 5
    assert Scenario.model_validate(read_json(folder / "truth" / "scenario.json")) == scene
    assert read_json(folder / "truth" / "scenario.json")["render"]["engine"] == "scalar"
    assert {"board.toml", "module.toml", "encoder.csv", "tof"} & {p.name for p in folder.iterdir()} == {
        "calibration": {"board.toml"},
        "module": {"module.toml"},
        "belt_empty": set(),
        "belt_loaded": {"tof"},
        "belt_moving": {"encoder.csv"},
    }[kind]
    assert list(folder.rglob(".*")) == []


@pytest.mark.parametrize("kind", ["module", "belt_empty", "belt_loaded"])
def test_depth_of_a_still_scene_is_on_the_cores_grid(simulated, kind):
    truth = simulated(kind) / "truth"
    depth = np.load(truth / f"{kind}_depth.npz")["depth_mm"]
    assert depth.shape == (142, 172)
    assert 400 < np.nanmedian(depth) < 760
    assert (truth / f"{kind}_scene.json").is_file()
    assert (truth / f"{kind}_module.json").is_file() == (kind == "module")
    assert (truth / f"{kind}_rocks.npz").is_file() == (kind == "belt_loaded")
    assert (truth / "projector.json").is_file() == (kind != "module")


def test_board_and_module_can_be_read(simulated):
    board = read_board(simulated("calibration") / "board.toml")
    assert isinstance(board, CharucoBoard)
    assert board.squares == (11, 8)
    poses = read_json(simulated("calibration") / "truth" / "board_poses.json")["frames"]
    assert list(poses) == ["000", "001"]
    assert read_module(simulated("module") / "module.toml").features


def test_encoder_records_the_travel_of_the_belt(simulated):
    lines = (simulated("belt_moving") / "encoder.csv").read_text().splitlines()
    assert lines[0] == "frame,timestamp_s,belt_position_mm"
    rows = [line.split(",") for line in lines[1:]]
    assert [row[0] for row in rows] == ["000", "001", "002"]
    values = np.array([row[1:] for row in rows], float)
    np.testing.assert_allclose(values, [[0, 0], [0.2, 102], [0.4, 204]])


def test_true_depth_moves_with_the_belt(simulated):
    truth = simulated("belt_moving") / "truth"
    arrays, document = np.load(truth / "belt_moving_depth.npz"), read_json(truth / "belt_moving.json")
    assert arrays["depth_mm"].shape == arrays["label"].shape == (3, 264, 320)
    rig = read_rig(truth / "rig.json")
    station = read_json(truth / "station.json")["core_from_world"]
    world_from_core = Pose.of(station["rotation"], station["translation_mm"]).inverse()
    rays = np.concatenate([rig.core_camera.rays(), np.ones((264, 320, 1))], axis=-1)
    at = [frame["heap_mm"] for frame in document["frames"]]
    np.testing.assert_allclose(np.diff(at), 100)

    def heights(frame: int, heap_mm: float) -> np.ndarray:
        """(20, 20) mean height of the load over cells that travel with the heap; NaN where there is none."""
        depth, label = arrays["depth_mm"][frame], arrays["label"][frame]
        x, y, z = world_from_core.apply((rays * depth[..., None])[label == 2]).T
        edges = [np.linspace(-200, 200, 21)] * 2
        total = np.histogram2d(x, y - heap_mm, edges, weights=z)[0]
        count = np.histogram2d(x, y - heap_mm, edges)[0]
        return np.where(count > 5, total / np.maximum(count, 1), np.nan)

    first = heights(0, at[0])
    assert np.nanmedian(abs(heights(2, at[2]) - first)) < 2
    assert np.nanmedian(abs(heights(2, at[0]) - first)) > 4
    assert document["heap_volume_mm3"] > 0
    load = np.load(truth / "belt_moving_load.npz")
    assert np.trapezoid(load["area_mm2"], load["y_mm"]) == pytest.approx(
        document["heap_volume_mm3"], rel=0.01
    )


def test_time_of_flight_camera_writes_a_reconstruction(simulated):
    tof, truth = simulated("belt_loaded") / "tof", simulated("belt_loaded") / "truth"
    rig = read_rig(tof / "rig.json")
    assert rig.core_camera.size_px == (64, 48)
    depth = read_float_tiff(tof / "000" / "depth.tiff")
    assert depth.shape == (48, 64)
    for name in ("sigma", "amplitude"):
        assert read_float_tiff(tof / "000" / f"{name}.tiff").shape == (48, 64)
    true = np.load(truth / "belt_loaded_depth.npz")["depth_mm"]
    assert np.nanmedian(depth[20:28, 28:36]) == pytest.approx(np.nanmedian(true[65:77, 79:93]), abs=30)


REFUSED = [
    ({"faults": {fault: [{"camera": "cam9", **more}]}}, InputError, "has no camera cam9; it has cam0, cam1")
    for fault, more in (
        ("dirt", {"specks_px": [[1, 1, 1]]}),
        ("moved_camera", {}),
        ("over_exposure", {}),
        ("missing_frames", {}),
    )
] + [
    ({"rig": {"file": "gone.json"}}, InputError, "gone.json: no such file"),
    ({"module": {"file": "gone.toml"}}, InputError, "gone.toml: no such file"),
    ({"rig": {"distortion": (-3.0, 0.0, 0.0, 0.0, 0.0)}}, InputError, "distortion"),
    ({"projector": {"size_px": (64, 64), "pattern": "dense"}}, SettingsError, "dots"),
]


@pytest.mark.parametrize(("more", "error", "line"), REFUSED)
def test_unrenderable_scene_is_refused_before_anything_is_written(tmp_path, more, error, line):
    with pytest.raises(error) as refusal:
        simulate(tiny("module", **more), tmp_path / "out", Silent())
    assert line in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "out").exists()


def test_two_captures_are_not_mixed(tmp_path):
    scene = {"speckle": False, "rig": {"auxiliaries": 1, "size_px": (96, 80), "pitch_um": 50.0}}
    simulate(tiny("belt_empty", frames=2, **scene), tmp_path, Silent())
    first = (tmp_path / "cam0" / "000.png").read_bytes()
    simulate(tiny("belt_empty", frames=2, **scene), tmp_path, Silent())  # its own images may be written anew
    assert (tmp_path / "cam0" / "000.png").read_bytes() == first
    with pytest.raises(InputError, match=r"holds another capture \(cam0/001\.png\); choose another folder"):
        simulate(tiny("belt_empty", frames=1, seed=2, **scene), tmp_path, Silent())
    assert (tmp_path / "cam0" / "000.png").read_bytes() == first


FRAMES = 3 if THOROUGH else 2


def test_board_is_detected_at_its_true_position(tmp_path):
    """Images, lens, poses and board agree: corners are found without a common error, to some hundredths of a px."""
    scene = tiny(
        "calibration",
        frames=FRAMES,
        rig={"size_px": (480, 400), "pitch_um": 3.45 * 5.1, "auxiliaries": 1},
        render={"oversample": 2, "passes": 2, "ambient_samples": 1},
        board={"file": _large_board(tmp_path), "reach": 0.3, "tilt_deg": 25.0},
    )
    stage = SimulatedScene(scene)
    assert stage.board is not None
    find, points, errors = make_detector(stage.board, DEFAULT_VARIANT), corner_points_mm(stage.board), []
    for frame in range(FRAMES):
        for name, image in stage.render_frame(frame).images.items():
            corners = find(image)
            if corners is None:
                continue
            pose = stage.station.cam_from_world(name) @ stage.world_from_board[frame]
            true = stage.station.rig.cameras[name].project(pose.apply(points[corners.ids]))
            errors.append(corners.pixels - true)
    found = np.concatenate(errors)
    assert len(errors) >= 2 * FRAMES - 1
    assert np.linalg.norm(found.mean(axis=0)) < 0.01
    assert np.sqrt((found**2).sum(axis=1).mean()) < 0.03


def _large_board(folder: Path) -> Path:
    path = folder / "large.toml"
    path.write_text(
        'kind = "charuco"\nsquares = [6, 5]\nsquare_mm = 60\nmarker_mm = 45\ndictionary = "DICT_4X4_50"\n'
    )
    return path
