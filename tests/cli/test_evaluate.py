"""``evaluate depth`` on a reconstruction: scores, and refused input in one line."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.json_text import write_json
from beltscape.files.rig_json import write_rig
from beltscape.files.tiff import write_float_tiff

SIZE = (40, 30)


@pytest.fixture
def folders(tmp_path):
    """A reconstruction that is 0.5 mm too deep on its left half, and its truth."""
    cameras = {
        name: Camera(name, SIZE, np.full(2, 40.0), np.array([19.5, 14.5]), np.zeros(5))
        for name in ("cam0", "cam1")
    }
    rig = Rig("cam0", cameras, {"cam0": Pose.identity(), "cam1": Pose.of([0, 0, 0], [-200, 0, 0])})
    found, truth = tmp_path / "found", tmp_path / "truth"
    for folder in (found, truth):
        folder.mkdir()
        write_rig(folder / "rig.json", rig)
    depth = np.full(SIZE[::-1], 700.0, np.float32)
    pose = {"rotation": np.diag([1.0, -1, -1]), "translation_mm": [0, 0, 700]}
    write_json(truth / "station.json", {"core_from_world": pose})
    np.savez(truth / "belt_empty_depth.npz", depth_mm=depth, label=np.ones(SIZE[::-1], np.uint8))
    depth[:, :20] += 0.5
    write_float_tiff(found / "000" / "depth.tiff", depth)
    write_float_tiff(found / "000" / "sigma.tiff", np.full(depth.shape, 0.25, np.float32))
    return found, truth


def test_the_numbers(folders, capsys):
    found, truth = folders
    assert main(["evaluate", "depth", str(found), "--truth", str(truth), "--json"]) == 0
    regions = json.loads(capsys.readouterr().out)["frames"][0]["regions"]
    assert set(regions) == {"belt", "all"}
    assert regions["belt"]["coverage"] == 1
    assert regions["belt"]["within_1mm"] == 1
    assert regions["belt"]["within_quarter_mm"] == pytest.approx(0.5)
    assert regions["belt"]["locking_px"] is None


def test_one_frame_folder_and_the_text(folders, capsys):
    found, truth = folders
    npz = truth / "belt_empty_depth.npz"
    assert main(["evaluate", "depth", str(found / "000"), "--truth", str(npz), "--within", "100"]) == 0
    text = capsys.readouterr().out
    assert "belt" in text
    assert "50.0%" in text
    assert "nan" not in text


@pytest.mark.parametrize("given", ["{found}", "{found}/000", "{found}/000/depth.tiff"])
def test_depths_of_any_method_are_scored_without_rig_and_sigma(folders, capsys, given):
    found, truth = folders
    words = ["evaluate", "depth", given.format(found=found), "--truth", str(truth), "--json"]
    assert main(words) == 0
    whole = json.loads(capsys.readouterr().out)["frames"]
    (found / "rig.json").unlink()
    (found / "000" / "sigma.tiff").unlink()
    assert main(words) == 0
    (frame,) = json.loads(capsys.readouterr().out)["frames"]
    own, before = frame["regions"]["belt"], whole[0]["regions"]["belt"]
    assert frame["frame"] == "000"
    for key in ("coverage", "within_1mm", "within_quarter_mm", "gross", "interior_median_mm"):
        assert own[key] == pytest.approx(before[key]), key
    assert before["sigma_ratio"] is not None
    assert own["sigma_ratio"] is None and own["sigma_ratio_low"] is None
    assert main(words[:-1]) == 0
    assert "nan" not in capsys.readouterr().out


@pytest.mark.parametrize("with_rig", [True, False])
def test_the_truth_may_be_a_tiff(folders, capsys, with_rig):
    found, truth = folders
    write_float_tiff(truth / "depth.tiff", np.full(SIZE[::-1], 700.0, np.float32))
    if not with_rig:
        (truth / "rig.json").unlink()
    assert main(["evaluate", "depth", str(found), "--truth", str(truth / "depth.tiff"), "--json"]) == 0
    regions = json.loads(capsys.readouterr().out)["frames"][0]["regions"]
    assert set(regions) == {"all"}
    assert regions["all"]["within_quarter_mm"] == pytest.approx(0.5)


def test_depths_of_another_size_than_the_truth_are_named(folders, capsys):
    found, truth = folders
    (found / "rig.json").unlink()
    write_float_tiff(found / "000" / "depth.tiff", np.full((10, 12), 700.0, np.float32))
    (found / "000" / "sigma.tiff").unlink()
    assert main(["evaluate", "depth", str(found), "--truth", str(truth)]) == 2
    assert (
        "12×10 px, but the core camera of the truth has 40×30; give depths on its" in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["depth", "{found}", "--truth", "{found}"], "no *_depth.npz"),
        (["depth", "{truth}", "--truth", "{truth}"], "no frame with depth.tiff"),
        (["depth", "{found}", "--truth", "{truth}", "--within", "-1"], "--within -1: must be greater than 0"),
        (["paper", "--captures", "{found}", "--out", "{found}/out"], "no such capture"),
    ],
)
def test_what_is_wrong_is_one_line(folders, capsys, arguments, said):
    found, truth = folders
    words = [word.format(found=found, truth=truth) for word in arguments]
    assert main(["evaluate", *words]) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1
