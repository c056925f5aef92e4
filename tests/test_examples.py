"""The examples: their scenes and commands are valid; the short ones are run."""

from __future__ import annotations

import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from pydantic import BaseModel

from beltscape.cli.catalogue import COMMANDS, load_command
from beltscape.cli.main import OneLineParser
from beltscape.files.rig_json import read_rig
from beltscape.files.toml_text import read_toml
from beltscape.pipeline.plan import read_plan_settings
from beltscape.pipeline.simulation import read_scenario
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from tests.thorough import list_cases

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
SCENES = sorted(EXAMPLES.rglob("02_simulate/*.toml"))
SHELL = sorted(EXAMPLES.rglob("*.sh"))
PYTHON = sorted(EXAMPLES.rglob("*.py"))


def read_commands(path: Path) -> list[list[str]]:
    """Arguments of each call of the program in a shell script."""
    text = path.read_text().replace("\\\n", " ")
    lines = [line.strip() for line in text.splitlines() if line.strip().startswith("beltscape ")]
    return [shlex.split(line, comments=True)[1:] for line in lines]


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_every_scene_is_taken_and_small(scene):
    scenario = read_scenario(str(scene), {})
    scene = SimulatedScene(scenario)
    assert scene.station.rig.core_camera.size_px[0] <= 612
    assert scene.frame_count <= 16
    faults = scenario.faults
    for fault in (*faults.dirt, *faults.moved_camera, *faults.over_exposure, *faults.missing_frames):
        assert fault.camera in scene.station.rig.cameras


def test_scenes_show_every_kind_but_the_empty_belt_and_the_usual_faults():
    scenarios = [read_scenario(str(scene), {}) for scene in SCENES]
    assert {s.kind for s in scenarios} == {"calibration", "module", "belt_loaded", "belt_moving"}
    shown = {name for s in scenarios for name, value in s.faults if value}
    assert shown == {"dirt", "moved_camera", "missing_frames", "over_exposure"}


def test_the_rig_of_ones_own_belt_stands_as_its_file_says():
    rig = read_rig(EXAMPLES / "02_simulate/own_rig.json")
    spec = read_scenario(str(EXAMPLES / "02_simulate/own_rig.toml"), {}).rig
    found = SimulatedScene(Scenario(kind="belt_loaded", rig=spec)).station
    assert found.core_from_world.center_mm[2] == spec.height_mm
    assert found.rig.cam_from_core["cam1"].center_mm == pytest.approx(rig.cam_from_core["cam1"].center_mm)


def test_the_plan_is_taken():
    path = EXAMPLES / "00_plan_a_rig/plan.toml"
    assert read_plan_settings(path, {}).belt.width_mm == read_toml(path)["belt"]["width_mm"]


@pytest.mark.parametrize("script", SHELL, ids=lambda path: path.parent.name)
def test_every_documented_command_exists(script):
    calls = read_commands(script)
    assert calls
    for command, *arguments in calls:
        assert command in COMMANDS
        parser = OneLineParser(prog=command)
        load_command(command).add_arguments(parser)
        parser.parse_args(arguments)  # leaves with 2 where an argument is unknown


@pytest.mark.slow
@pytest.mark.parametrize("name", list_cases(["00_plan_a_rig", "01_targets"], {"00_plan_a_rig"}))
def test_the_short_scripts_run(tmp_path, name):
    program = tmp_path / "bin/beltscape"
    program.parent.mkdir()
    start = "import sys; from beltscape.cli.main import main; sys.exit(main())"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{start}" "$@"\n')
    program.chmod(0o755)
    path = os.pathsep.join([str(program.parent), os.environ["PATH"]])
    done = subprocess.run(
        ["sh", str(EXAMPLES / name / "run.sh"), str(tmp_path / "out")],
        cwd=ROOT,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "too little light" not in done.stderr


@pytest.mark.parametrize("script", PYTHON, ids=lambda path: path.stem)
def test_every_python_example_imports_what_there_is(script):
    assert callable(runpy.run_path(str(script))["main"])


@pytest.mark.slow
def test_frames_come_from_the_simulated_source(capsys):
    runpy.run_path(str(EXAMPLES / "04_frame_source.py"), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "cameras cam0, cam1, cam2"
    assert len([line for line in lines if "uint8" in line]) == 9
    assert lines[-1].endswith("[-150, 0, 150]")


def models(model: type[BaseModel], name: str = "") -> dict[str, type[BaseModel]]:
    """By table's name, the model that a scene's file is read with."""
    found = {name: model}
    for key, field in model.model_fields.items():
        here = f"{name}.{key}" if name else key
        for kind in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                found |= models(kind, here)
    return found


def format_default(value: object) -> str:
    """A default as the manual has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(format_default(one) for one in value) + "]"
    if isinstance(value, float):
        return f"{value:.0f}" if value >= 1e6 else f"{value:g}"
    return f'"{value}"' if isinstance(value, str) else str(value)


@pytest.mark.parametrize(("name", "model"), models(Scenario).items())
def test_the_manual_has_every_key_with_its_default(name, model):
    text = (ROOT / "docs/reference/scene.md").read_text()
    title = rf"\*\*`\[+{re.escape(name)}\]+`\*\*" if name else r"\*\*Keys at the top\*\*"
    (head,) = re.finditer(title, text)
    table = text[head.end() :].split("\n\n")[1]
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*?) \|", table, flags=re.MULTILINE))
    tables = {inner.rsplit(".", 1)[-1] for inner in models(Scenario) if inner.rpartition(".")[0] == name}
    keys = {key: field for key, field in model.model_fields.items() if key not in tables}
    expected = {
        key: "required"
        if field.is_required()
        else "—"
        if field.default is None
        else f"`{format_default(field.default)}`"
        for key, field in keys.items()
    }
    assert rows == expected
