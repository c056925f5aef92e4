"""``beltscape measure features``: output, files and refused input."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.core.depth import DepthMap
from beltscape.files.images import read_image, write_image
from beltscape.files.reconstruction import write_frame
from beltscape.files.rig_json import write_rig
from beltscape.stereo.pointcloud import cloud_from_depth
from tests.report.layout import text_faults
from tests.synthetic.demo import parse_json
from tests.synthetic.modules import DepthCameraView, module, module_pose, rig

TOML = """
name = "laboratory"
[base]
size_mm = [285, 200, 10]
[[cube]]
name = "cube100"
edge_mm = 100
center_mm = [-80, -42]
[[cube]]
name = "cube60"
edge_mm = 60
center_mm = [20, 52]
[[sphere]]
name = "sphere70"
diameter_mm = 70
center_mm = [90, -45]
[[cylinder]]
name = "rod"
diameter_mm = 24
height_mm = 70
center_mm = [-90, 65]
"""


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    """A frame folder with a module in it, image.png included, and its module.toml beside the rig."""
    folder = tmp_path_factory.mktemp("module")
    cubes = [cube.model_dump() for cube in module().cube[:2]]
    seen = DepthCameraView(module(cube=cubes), module_pose(5, -5, -30))
    depth, image = seen.depth(), np.clip(seen.render_brightness(), 0, 255).astype(np.uint8)
    camera = rig().core_camera
    cloud = cloud_from_depth(depth, camera, None)
    write_frame(folder / "000", depth, cloud, np.zeros((4, 4, 3), np.uint8), image)
    write_rig(folder / "rig.json", rig())
    (folder / "module.toml").write_text(TOML)
    return folder / "000"


@pytest.fixture(scope="module")
def measured(frame, tmp_path_factory):
    """The printed answer and the folder of the files; nobody writes into it."""
    out = tmp_path_factory.mktemp("measured")
    words = ["measure", "features", frame, "--module", frame.parent / "module.toml", "--out", out, "--json"]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main([*map(str, words)]) == 0
    return printed.getvalue(), out


def test_answer_and_files_follow_the_contract(measured):
    text, out = measured
    answer = parse_json(text)
    names = [(f["name"], f["quantity"]) for f in answer["features"]]
    assert names == [
        ("base", "length"), ("base", "width"), ("cube100", "edge"), ("cube100", "height"), ("cube60", "edge"),
        ("cube60", "height"), ("sphere70", "radius"), ("rod", "diameter"), ("rod", "height"),
        ("step:cube100-cube60", "height_difference"),
    ]  # fmt: skip
    for feature in answer["features"]:
        assert set(feature) == {"name", "quantity", "nominal_mm", "measured_mm", "sigma_mm", "points"}
        assert abs(feature["measured_mm"] - feature["nominal_mm"]) < 0.5
        assert feature["sigma_mm"] > 0
    assert answer["pose"]["agreement"] > 0.6
    assert np.linalg.det(answer["pose"]["core_from_module"]["rotation"]) == pytest.approx(1)
    assert answer["warnings"] == []
    assert json.loads((out / "features.json").read_text())["features"] == answer["features"]
    rows = list(csv.DictReader((out / "features.csv").read_text().splitlines()))
    assert [(row["name"], row["quantity"]) for row in rows] == names
    assert float(rows[3]["measured_mm"]) == pytest.approx(100, abs=0.002)
    page = (out / "report.html").read_text()
    assert "Dimensions of laboratory" in page
    assert text_faults(page) == []


@pytest.mark.thorough
def test_plain_image_replaces_the_patterned_one_at_edges(run, frame, measured, tmp_path):
    toml, dots = frame.parent / "module.toml", tmp_path / "dots.png"
    noise = np.random.default_rng(1).integers(0, 255, (512, 612), dtype=np.uint8)
    write_image(dots, noise)
    words = "measure", "features", frame, "--module", toml, "--json", "--image", dots
    first, second = (parse_json(text)["features"] for text in (measured[0], run(*words)[1]))
    sigmas = [
        (a["sigma_mm"], b["sigma_mm"]) for a, b in zip(first, second, strict=True) if a["quantity"] == "edge"
    ]
    assert all(b > 1.5 * a for a, b in sigmas)  # noise shows no edges, and is not believed to


def test_viewer_draws_the_measured_features(run, frame, measured, tmp_path):
    out, page = measured[1], tmp_path / "scene.html"
    assert run("view", frame, "--features", out / "features.json", "--out", page)[0] == 0
    held = re.search(r'<script id="scene" type="application/json">(.*?)</script>', page.read_text(), re.S)
    assert held is not None
    scene = json.loads(held[1])
    names = {label["text"] for label in scene["labels"]}
    assert {"base", "cube100", "cube60", "sphere70", "rod"} <= names
    drawn = [np.array(line["line"]) for line in scene["lines"] if line["layer"] == "features"]
    answer = json.loads((out / "features.json").read_text())
    cube = next(solid for solid in answer["solids"] if solid["name"] == "cube100")
    assert cube["measured"]
    assert cube["size_mm"] == pytest.approx([100, 100, 100], abs=0.5)
    # rings of four edges: the base's and the cubes', each as long as it was measured
    edges = [np.linalg.norm(np.diff(ring, axis=0), axis=1) for ring in drawn if len(ring) == 5]
    assert len(edges) == 2 * 3
    assert edges[2] == pytest.approx(cube["size_mm"][:1] * 4, abs=0.02)  # the page rounds to 0.01 mm


@pytest.mark.thorough
def test_result_is_deterministic(run, frame, measured, tmp_path):
    run("measure", "features", frame, "--module", frame.parent / "module.toml", "--out", tmp_path)
    for file in ("features.json", "features.csv", "report.html"):
        assert (tmp_path / file).read_bytes() == (measured[1] / file).read_bytes()


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (TOML.replace("edge_mm = 60", "edge_mm = -60"), "edge_mm"),
        (TOML.replace('name = "cube60"', 'name = "cube100"'), "cube100"),
        (TOML.replace("[base]", "[plate]"), "base"),
        ("[base\n", "module.toml"),
    ],
)
def test_bad_module_is_refused_in_one_line(run, frame, tmp_path, text, word):
    path = tmp_path / "module.toml"
    path.write_text(text)
    code, out, err = run("measure", "features", frame, "--module", path)
    assert (code, out) == (2, "")
    assert len(err) == 1
    assert "module.toml" in err[0]
    assert word in err[0]


def test_mismatched_inputs_are_refused(run, frame, tmp_path):
    toml, small = frame.parent / "module.toml", tmp_path / "small.png"
    write_image(small, np.zeros((40, 60), np.uint8))
    bad = [
        (("measure", "features", tmp_path / "none", "--module", toml), "no such folder"),
        (("measure", "features", frame, "--module", tmp_path / "no.toml"), "no.toml"),
        (("measure", "features", frame, "--module", toml, "--image", small), "60×40"),
        (("measure", "features", frame, "--module", toml, "--image", toml), "not a readable image"),
    ]
    for words, say in bad:
        code, out, err = run(*words)
        assert (code, out) == (2, "")
        assert len(err) == 1
        assert say in err[0]


def test_image_of_another_size_is_refused(run, frame, tmp_path):
    depth = DepthCameraView(module(), module_pose()).depth()
    camera = rig().core_camera
    nothing = DepthMap(depth.depth_mm, depth.sigma_mm, depth.views, depth.confidence)
    folder = tmp_path / "r" / "000"
    write_frame(folder, nothing, cloud_from_depth(depth, camera, None), np.zeros((4, 4, 3), np.uint8))
    write_rig(folder.parent / "rig.json", rig())
    write_image(folder / "image.png", np.zeros((40, 60), np.uint8))
    code, _, err = run("measure", "features", folder, "--module", frame.parent / "module.toml")
    assert code == 2
    assert "image.png" in err[0]


def test_reconstruct_writes_the_core_image_on_the_grid_of_the_depth_map(demo_run):
    folder = demo_run / "out" / "belt_loaded" / "000"
    image, depth = read_image(folder / "image.png"), read_image(folder / "views.png")
    assert image.shape[:2] == depth.shape
    assert image.any()
