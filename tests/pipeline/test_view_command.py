"""``beltscape view`` of a rig, a frame or a sequence, with belt and primitives."""

from __future__ import annotations

import json
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from beltscape.core.cloud import PointCloud
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.json_text import write_json
from beltscape.files.reconstruction import write_frame
from beltscape.files.rig_json import write_rig
from tests.synthetic.packings import camera, make_ellipsoids, render_depth_map

BELT = {
    "belt_from_core": {"rotation": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "translation_mm": [0, 0, 700]},
    "x_mm": [-200, 0, 200],
    "z_mm": [30, 0, 30],
}
FEATURES = {
    "features": [],
    "pose": {
        "core_from_module": {"rotation": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "translation_mm": [0, 0, 700]}
    },
    "solids": [
        {"name": "cube 1", "kind": "box", "center_mm": [0, 0, 20], "size_mm": [40, 40, 40]},
        {"name": "ball", "kind": "sphere", "center_mm": [60, 0, 25], "diameter_mm": 50.0},
        {"name": "post", "kind": "cylinder", "center_mm": [0, 60, 5], "diameter_mm": 8, "height_mm": 10},
    ],
}
UNFIT = {
    "unrelated.json": {"a": 1},
    "list.json": [1],
    "rig-like.json": {"format": "beltscape-rig/1"},
    "old.json": {key: value for key, value in FEATURES.items() if key != "solids"},
    "torus.json": {**FEATURES, "solids": [{"name": "x", "kind": "torus", "center_mm": [0, 0, 0]}]},
    "short.json": {**FEATURES, "solids": [{"name": "x", "kind": "sphere", "center_mm": [0, 0]}]},
}
"""Name → a document that is no features.json, or none that can be drawn."""


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seq")
    eye = camera(200, 160, 230.0)
    aside = Pose(np.eye(3), np.array([-150.0, 0.0, 0.0]))
    rig = Rig("core", {"core": eye, "left": eye}, {"core": Pose(np.eye(3), np.zeros(3)), "left": aside})
    write_rig(folder / "rig.json", rig)
    depth, _ = render_depth_map(make_ellipsoids(np.random.default_rng(4), columns=3, rows=3), eye)
    points = depth.points_mm(eye)[depth.measured].astype(np.float32)
    up = np.broadcast_to(np.array([0, 0, -1], np.float32), points.shape)
    for name in ("000", "001", "002"):
        cloud = PointCloud(points, up, np.full(points.shape, 90, np.uint8), depth.sigma_mm[depth.measured])
        write_frame(folder / name, depth, cloud, np.zeros((4, 4, 3), np.uint8))
    write_json(folder / "belt.json", BELT)
    write_json(folder / "features.json", FEATURES)
    for name, document in UNFIT.items():
        write_json(folder / name, document)
    return folder


def scene_of(path):
    """What the page holds for its script."""
    page = path.read_text()
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//|@import|fetch\(""", page)
    held = re.search(r'<script id="scene" type="application/json">(.*?)</script>', page, re.S)
    assert held is not None
    return json.loads(held[1])


def test_sequence_has_a_cloud_per_frame(run, frames, tmp_path):
    out = tmp_path / "scene.html"
    code, text, _ = run("view", frames, "--out", out)
    assert (code, text) == (0, f"view {out}\n")
    scene = scene_of(out)
    assert [frame["name"] for frame in scene["frames"]] == ["000", "001", "002"]
    assert all(frame["count"] == 200 * 160 for frame in scene["frames"])
    low, step = (np.array(scene["frames"][0][name]) for name in ("low", "step"))
    high = low + 65_535 * step
    assert high[2] == pytest.approx(-640, abs=30)  # z is upwards
    assert low[2] == pytest.approx(-700, abs=0.1)
    assert {label["text"] for label in scene["labels"]} == {"core", "left"}


def test_frame_with_belt_and_primitives_is_in_the_belt_frame(run, frames, tmp_path):
    out = tmp_path / "scene.html"
    words = ("--belt", frames / "belt.json", "--features", frames / "features.json")
    assert run("view", frames / "001", *words, "--out", out)[0] == 0
    scene = scene_of(out)
    assert len(scene["frames"]) == 1
    assert scene["frames"][0]["low"][2] == pytest.approx(0, abs=0.1)
    (belt,) = scene["surfaces"]
    assert len(belt["triangles"]) == 3 * 4
    cube = np.array([p for line in scene["lines"] if line["layer"] == "features" for p in line["line"]])
    assert cube[:, 2].min() == pytest.approx(0, abs=0.1)
    assert cube[:, 2].max() == pytest.approx(50, abs=0.5)
    assert len(cube) == 2 * 5 + 4 * 2 + 3 * 49 + 2 * 49 + 4 * 2
    assert {"cube 1", "ball", "post"} <= {label["text"] for label in scene["labels"]}


def test_rig_without_frames_is_shown(run, frames, tmp_path):
    out = tmp_path / "scene.html"
    assert run("view", frames / "rig.json", "--out", out)[0] == 0
    scene = scene_of(out)
    assert scene["frames"] == []
    assert len(scene["lines"]) == 2 * 5


def test_browser_opens_without_out(run, frames, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    code, text, _ = run("view", frames / "000")
    assert code == 0
    assert text.endswith("opened in the browser\n")
    assert opened[0].startswith("file://")


def test_large_clouds_are_thinned(run, frames, tmp_path, monkeypatch):
    monkeypatch.setattr("beltscape.pipeline.view._POINTS", 9000)
    assert run("view", frames / "000", "--out", tmp_path / "scene.html")[0] == 0
    (frame,) = scene_of(tmp_path / "scene.html")["frames"]
    assert frame["count"] == 100 * 80
    assert frame["spacing"] == pytest.approx(2 * 3.04, rel=0.3)


def test_missing_rerun_is_reported_in_one_line(run, frames, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    code, _, error = run("view", frames, "--rerun")
    assert code == 2
    assert error == ["beltscape: --rerun: rerun-sdk is not installed; pip install 'beltscape[viewer]'"]


def test_rerun_receives_all_contents(run, frames, tmp_path, monkeypatch):
    logged = []

    class Stream:
        def __init__(self, name, recording_id):
            assert (name, recording_id) == ("beltscape", frames.name)

        def save(self, path):
            assert path == str(tmp_path / "view.rrd")

        def log(self, entity, what, static=False):
            logged.append((entity, static, what))

        def set_time(self, timeline, sequence):
            logged.append((timeline, sequence))  # pyrefly: ignore[bad-argument-type]

        def flush(self):
            logged.append(("flush", True))  # pyrefly: ignore[bad-argument-type]

    kinds = ("LineStrips3D", "Points3D", "Mesh3D", "TextLog")
    rerun = SimpleNamespace(RecordingStream=Stream, ViewCoordinates=SimpleNamespace(RIGHT_HAND_Z_UP="up"))
    for kind in kinds:
        setattr(rerun, kind, lambda *arguments, **options: (arguments, options))
    monkeypatch.setitem(sys.modules, "rerun", rerun)
    words = ("--belt", frames / "belt.json", "--features", frames / "features.json")
    assert run("view", frames, "--rerun", *words, "--out", tmp_path / "view.rrd")[0] == 0
    entities = [entity for entity, *_ in logged]
    assert entities.count("cloud") == 3
    assert {"cameras/lines", "cameras/names", "belt", "features/lines"} <= set(entities)
    assert entities[-1] == "flush"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none"], "holds neither rig.json nor frames"),
        (["{frames}/000", "--belt", "{frames}/features.json"], "no pose belt_from_core"),
        (["{frames}/000", "--features", "none.json"], "none.json: no such file"),
        (["{frames}/000", "--features", "{frames}/unrelated.json"], "unrelated.json: is no features.json"),
        (["{frames}/000", "--features", "{frames}/list.json"], "list.json: is no features.json"),
        (["{frames}/000", "--features", "{frames}/rig-like.json"], "rig-like.json: is no features.json"),
        (
            ["{frames}/000", "--features", "{frames}/old.json"],
            "old.json: contains no solids, because an earlier version wrote it",
        ),
        (["{frames}/000", "--features", "{frames}/torus.json"], "kind 'torus'"),
        (["{frames}/000", "--features", "{frames}/short.json"], "run beltscape measure features again"),
    ],
)
def test_invalid_input_is_refused_in_one_line(run, frames, words, message, tmp_path):
    arguments = [word.format(frames=frames) for word in words]
    code, out, error = run("view", *arguments, "--out", tmp_path / "scene.html")
    assert (code, out) == (2, "")
    (line,) = error
    assert message in line
    assert not (tmp_path / "scene.html").exists()
