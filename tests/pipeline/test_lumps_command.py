"""``beltscape measure lumps``: output, files and refused input."""

from __future__ import annotations

import csv

import cv2
import numpy as np
import pytest

from beltscape.core.cloud import PointCloud
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.json_text import read_json
from beltscape.files.reconstruction import write_frame
from beltscape.files.rig_json import write_rig
from tests.synthetic.belts import S_MM, make_belt, write_belt_folder
from tests.synthetic.demo import parse_json
from tests.synthetic.packings import Solid, camera, make_ellipsoids, render_depth_map


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """A reconstruction with a loaded and an empty frame."""
    folder = tmp_path_factory.mktemp("lumps")
    eye = camera(420, 360, 490.0)
    write_rig(folder / "rig.json", Rig("core", {"core": eye}, {"core": Pose(np.eye(3), np.zeros(3))}))
    solids = make_ellipsoids(np.random.default_rng(4), columns=4, rows=4, pitch_mm=100, largest_mm=44)
    for name, content in (("loaded", solids), ("empty", list[Solid]())):
        depth, _ = render_depth_map(content, eye, noise_mm=0.05)
        points = depth.points_mm(eye)[depth.measured].astype(np.float32)
        grey = np.full(points.shape, 90, np.uint8)
        cloud = PointCloud(points, np.full_like(points, np.nan), grey, depth.sigma_mm[depth.measured])
        write_frame(folder / name, depth, cloud, np.zeros((4, 4, 3), np.uint8))
    return folder, solids


def test_answer_and_files_agree(run, frames, tmp_path):
    folder, solids = frames
    out = tmp_path / "out"
    code, text, _ = run(
        "measure", "lumps", folder / "loaded", "--empty", folder / "empty", "--oversize", 70,
        "--sieves", "20,40,80,160", "--out", out, "--json",
    )  # fmt: skip
    assert code == 0
    answer = parse_json(text)
    assert answer["frame"] == "belt"
    assert len(answer["lumps"]) == len(solids)
    assert answer["distribution"]["sieves_mm"] == [20, 40, 80, 160]
    assert answer["distribution"]["passing"][-1] == pytest.approx(1)
    assert answer["oversize"]["oversize"] == any(lump["size_mm"] > 70 for lump in answer["lumps"])
    assert "top layer" in answer["bias"]
    assert read_json(out / "lumps.json")["lumps"] == answer["lumps"]
    labels = cv2.imread(str(out / "labels.png"), cv2.IMREAD_UNCHANGED)
    assert labels is not None
    assert labels.dtype == np.uint16
    assert labels.shape == (360, 420)
    assert set(np.unique(labels)) - {0, 65535} == {lump["number"] for lump in answer["lumps"]}
    rows = list(csv.DictReader((out / "lumps.csv").read_text().splitlines()))
    assert [float(row["size_mm"]) for row in rows] == pytest.approx(
        [lump["size_mm"] for lump in answer["lumps"]], abs=0.006
    )
    assert (out / "sieve.csv").read_text().startswith("sieve_mm,passing,passing_fully_visible\n20,")
    page = (out / "report.html").read_text()
    assert "Lumps on the belt" in page
    assert "http" not in page.replace("http-equiv", "")


def test_empty_belt_has_no_lumps_and_a_report(run, frames, tmp_path):
    folder, _ = frames
    code, text, _ = run("measure", "lumps", folder / "empty", "--oversize", 50, "--out", tmp_path / "out")
    assert code == 0
    assert text.startswith("0 lumps")
    assert "no oversize" in text
    assert "No lumps in view" in (tmp_path / "out" / "report.html").read_text()


def test_empty_belt_is_read_from_a_belt_json(run, frames, tmp_path):
    folder, solids = frames
    belt = tmp_path / "belt.json"
    assert run("measure", "belt", folder, "--frames", "empty", "--out", belt)[0] == 0
    answers = [
        parse_json(run("measure", "lumps", folder / "loaded", "--empty", empty, "--json")[1])
        for empty in (belt, folder / "empty")
    ]
    assert len(answers[0]["lumps"]) == len(solids)
    for one, other in zip(answers[0]["lumps"], answers[1]["lumps"], strict=True):
        assert one["center_mm"] == pytest.approx(other["center_mm"], abs=1e-6)
        assert one["size_mm"] == pytest.approx(other["size_mm"])


def test_summary_states_the_sizes(run, frames):
    folder, solids = frames
    code, text, _ = run("measure", "lumps", folder / "loaded", "--oversize", 20)
    assert code == 0
    assert text.startswith(f"{len(solids)} lumps")
    assert "d50" in text
    assert "OVERSIZE" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--sieves", "20;40"], "--sieves 20;40"),
        (["--sieves", "40,20"], "ascend"),
        (["--oversize", "-1"], "--oversize -1: must be"),
        (["--empty", "none"], "none: no such file or folder; give a belt.json"),
    ],
)
def test_invalid_input_is_refused_in_one_line(run, frames, words, message):
    code, out, error = run("measure", "lumps", frames[0] / "loaded", *words)
    assert (code, out) == (2, "")
    (line,) = error
    assert message in line


@pytest.fixture
def flow(tmp_path):
    """The folder of a flow with three balls."""
    belt, _ = make_belt([(0.0, S_MM + 100 * number, 30.0) for number in (1, 2, 3)], 200)
    write_belt_folder(tmp_path / "flow", belt)
    return tmp_path / "flow"


def test_a_flow_has_each_lump_once_with_the_same_files(run, flow, tmp_path):
    out = tmp_path / "out"
    code, text, error = run("measure", "lumps", flow, "--oversize", 50, "--out", out, "--json")
    assert code == 0
    assert not any("--belt-cell" in line for line in error)
    answer = parse_json(text)
    assert answer["frame"] == "fused belt"
    assert [lump["center_mm"][1] for lump in answer["lumps"]] == pytest.approx([600, 700, 800], abs=3)
    assert answer["oversize"]["oversize"]
    labels = cv2.imread(str(out / "labels.png"), cv2.IMREAD_UNCHANGED)
    assert labels is not None
    assert labels.shape == (200, 100)
    rows = list(csv.DictReader((out / "lumps.csv").read_text().splitlines()))
    assert [float(row["s_mm"]) for row in rows] == pytest.approx([600, 700, 800], abs=3)
    assert "y_mm" not in rows[0]
    assert "Lumps on the belt" in (out / "report.html").read_text()
    assert (out / "sieve.csv").is_file()


def test_coarse_cells_of_a_flow_are_warned_of_and_an_empty_belt_is_refused(run, tmp_path):
    belt, _ = make_belt([(0.0, S_MM + 200, 60.0)], 100, cell_mm=4.0)
    write_belt_folder(tmp_path / "coarse", belt, pixel_mm=1.3)
    code, _, error = run("measure", "lumps", tmp_path / "coarse")
    assert code == 0
    assert any("--belt-cell 1.3" in line for line in error)
    code, _, error = run("measure", "lumps", tmp_path / "coarse", "--empty", tmp_path)
    assert code == 2
    assert "leave it out" in error[-1]
