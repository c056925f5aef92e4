"""``beltscape simulate`` as a command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from beltscape.cli.commands.simulate import SCENES, SIZES
from beltscape.cli.main import main
from beltscape.files.rig_json import read_rig
from beltscape.simulate.scenario import KINDS

SCENE = """
kind = "belt_empty"
speckle = false
[rig]
size_px = [192, 160]
pitch_um = 40
auxiliaries = 1
[render]
oversample = 1
passes = 1
ambient_samples = 1
"""


@pytest.fixture(autouse=True)
def desk(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(SCENE)
    return tmp_path


def test_help_lists_every_scene():
    assert tuple(KINDS) == SCENES


def test_json_is_one_document_that_names_what_was_written(capsys):
    words = ["scene.toml", "--out", "out", "--size", "half", "--frames", "2", "--seed", "5", "--json"]
    assert main(["simulate", *words]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["scene"], result["frames"], result["cameras"]) == ("belt_empty", 2, ["cam0", "cam1"])
    assert result["warnings"] == []
    assert sorted(p.name for p in Path(result["capture"], "cam1").iterdir()) == ["000.png", "001.png"]
    assert Path(result["preview"]).is_file()
    assert read_rig(Path(result["truth"], "rig.json")).core_camera.size_px == (96, 80)
    scenario = json.loads(Path(result["truth"], "scenario.json").read_text(encoding="utf-8"))
    assert (scenario["seed"], scenario["rig"]["scale"]) == (5, 0.5)


@pytest.mark.thorough
def test_options_and_a_given_rig_are_used(capsys):
    assert main(["simulate", "scene.toml", "--out", "first", "--size", "half"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "belt_empty: 1 frames of 2 cameras"
    words = ["--rig", "first/truth/rig.json", "--height", "700", "--size", "full", "--no-speckle", "--tof"]
    assert main(["simulate", "scene.toml", "--out", "second", *words]) == 0
    first, second = (read_rig(Path(out, "truth/rig.json")) for out in ("first", "second"))
    assert second.core_camera.size_px == first.core_camera.size_px
    assert (second.core_camera.focal_px == first.core_camera.focal_px).all()
    assert Path("second/tof/000/depth.tiff").is_file()
    station = json.loads(Path("second/truth/station.json").read_text(encoding="utf-8"))
    assert station["core_from_world"]["translation_mm"][2] == pytest.approx(700)
    assert not Path("second/truth/projector.json").exists()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["belt"], "beltscape: belt: no such scene; give a .toml file, or one of calibration, module"),
        (["gone.toml"], "beltscape: gone.toml: no such file"),
        (["module", "--frames", "0"], "beltscape: module: frames = 0: must be greater than or equal to 1"),
        (["module", "--height", "-3"], "beltscape: module: rig.height_mm = -3.0: must be greater than 0"),
        (["module", "--size", "third"], "beltscape simulate: argument --size: invalid choice: 'third'"),
        (["module", "--rig", "gone.json"], "beltscape: gone.json: no such file"),
        (["folding.toml"], "beltscape: "),
        (["fault.toml"], "beltscape: faults.moved_camera: the rig has no camera cam7; it has cam0, cam1"),
    ],
)
def test_invalid_scene_is_refused_in_one_line_and_nothing_is_written(capsys, words, line):
    Path("folding.toml").write_text(SCENE.replace("[rig]", "[rig]\ndistortion = [-3, 0, 0, 0, 0]"))
    Path("fault.toml").write_text(SCENE + '[[faults.moved_camera]]\ncamera = "cam7"\n')
    try:
        code = main(["simulate", *words, "--out", "out"])
    except SystemExit as stop:
        code = stop.code
    said = capsys.readouterr()
    assert code == 2
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert said.err.startswith(line)
    assert not Path("out").exists()


def test_every_size_merges_a_whole_number_of_pixels():
    assert all((1 / share).is_integer() for share in SIZES.values())


def test_help_imports_nothing_heavy():
    code = (
        "import argparse, sys\nimport beltscape.cli.commands.simulate as s\n"
        "s.add_arguments(argparse.ArgumentParser())\n"
        "print(sorted({'numpy', 'pydantic', 'cv2', 'mitsuba'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
