"""Steps and their state: in order, resumable, outdated when what they were made from changes, one at a time."""

from __future__ import annotations

import json
import os
import shutil
import tomllib
from pathlib import Path

import pytest

from beltscape.cli.main import main
from beltscape.commissioning import project_text, trial
from beltscape.commissioning.runner import StepRun
from beltscape.commissioning.state import FILE, CommissionState, parse_assignments
from beltscape.commissioning.steps import STEPS, find_next, find_step, get_status, list_commands
from beltscape.core.errors import InputError, SettingsError
from beltscape.core.progress import Silent
from beltscape.core.system_calls import lock_folder
from beltscape.files.toml_text import read_toml
from beltscape.pipeline.recording.project import read_recording_project
from tests.once import make_once
from tests.synthetic.small_demo import make_small_demo


@pytest.fixture
def plant(tmp_path, tmp_path_factory, monkeypatch) -> Path:
    """An empty folder, and the small demo in place of the shipped one."""
    demo = make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    monkeypatch.setattr(trial, "DEMO_FOLDER", demo)
    return tmp_path / "plant"


def run(plant: Path, step: str) -> dict:
    return StepRun(CommissionState(plant), Silent()).run(step)


def test_the_first_steps_of_the_trial_plant(plant):
    state = CommissionState(plant)
    assert find_next(state) == "cameras"
    assert [get_status(state, step) for step in STEPS[1:]] == ["blocked"] * (len(STEPS) - 1)
    state.change_settings({"source": "trial"})
    assert run(plant, "cameras") == {"cameras": 4, "names": ["cam0", "cam1", "cam2", "cam3"], "core": "cam0"}
    assert run(plant, "images")["faults"] == []
    assert run(plant, "trigger") == {"instants": 13, "incomplete": 0}
    run(plant, "board")
    assert (plant / "board/board.pdf").is_file()
    again = CommissionState(plant)  # another process
    assert find_next(again) == "calibrate"
    assert [get_status(again, step) for step in STEPS[:4]] == ["done"] * 4


def test_a_file_that_is_not_there_is_named_by_its_setting(plant, capsys):
    CommissionState(plant).change_settings({"source": "trial"})
    run(plant, "cameras")
    assert main(["commission", str(plant), "--set", "board.file=mine.toml", "--step", "board"]) == 2
    line = capsys.readouterr().err
    assert (
        f"board.file = 'mine.toml': there is no file {plant / 'mine.toml'}; correct it, or clear it for a"
        in line
    )


def test_captures_that_are_elsewhere_or_lack_images_are_named_with_the_fix(plant, tmp_path, capsys):
    mine = tmp_path / "mine"
    shutil.copytree(trial.DEMO_FOLDER / "calibration", mine / "calibration")
    words = ["commission", str(plant), "--set", "source=captures", "--step", "cameras", "--set"]
    for wrong in (str(mine / "calibration"), "nowhere"):
        assert main([*words, f"captures={wrong}"]) == 2
        line = capsys.readouterr().err
        assert f"captures = {wrong!r}: {plant / wrong / 'calibration'} is no folder" in line
        assert f"has calibration, empty and moving in it, absolute or from {plant}" in line
    for path in sorted((mine / "calibration/cam3").iterdir())[:4]:
        path.unlink()
    assert main([*words, f"captures={mine}"]) == 0
    with pytest.raises(
        InputError, match=r"4 of 13 instants lack images \(4 of cam3\): record them again; calibrating"
    ):
        run(plant, "trigger")


def test_a_finished_step_is_open_again_without_its_files_and_outdated_when_they_change(plant):
    state = CommissionState(plant)
    (plant / "rig").mkdir(parents=True)
    for name in ("rig.json", "calibration.json", "report.html"):
        (plant / "rig" / name).write_text("{}")
    state.finish("rig", {}, ("rig/rig.json",))
    assert get_status(state, find_step("rig")) == "done"
    (plant / "rig/rig.json").write_text('{"another": "rig"}')
    assert get_status(state, find_step("rig")) == "outdated"
    state.finish("calibrate", {}, ())
    assert get_status(state, find_step("calibrate")) == "done"
    (plant / "rig/report.html").unlink()
    assert get_status(state, find_step("calibrate")) in ("open", "blocked")


def test_a_step_that_is_not_due_says_which_comes_first(plant, capsys):
    assert main(["commission", str(plant), "--step", "empty"]) == 2
    assert "step empty: finish the step rig first" in capsys.readouterr().err
    assert main(["commission", str(plant), "--step", "calibrate"]) == 2
    assert "finish the step board first" in capsys.readouterr().err
    assert main(["commission", str(plant), "--step", "rigg"]) == 2
    assert "did you mean rig?" in capsys.readouterr().err


def test_settings_are_checked_as_a_whole_and_kept_on_the_disk(plant, capsys):
    words = ["commission", str(plant), "--json"]
    assert main([*words, "--set", "source=trial", "--set", "board.square_mm=34.5"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in document["steps"]] == [step.name for step in STEPS]
    kept = json.loads((plant / FILE).read_text())["settings"]
    assert kept == {"source": "trial", "board": {"square_mm": 34.5}}
    for wrong in ("source=satellite", "cmaera=x", "exposure_us=-3", "devices"):
        assert main([*words, "--set", wrong]) == 2
        assert wrong.split("=")[0] in capsys.readouterr().err
    assert json.loads((plant / FILE).read_text())["settings"] == kept


def test_the_encoder_is_answered_checked_and_written(plant, capsys):
    words = [
        "commission",
        str(plant),
        "--json",
        "--set",
        "source=cameras",
        "--set",
        "devices.cam0=192.168.10.11",
    ]
    for wrong, why in (
        ("encoder.kind=wheel", "encoder = {'kind': 'wheel'}: kind: "),
        ("encoder.kind=constant", "needs speed_mm_s"),
        ("camera_encoder.mm_per_count=0.05", "give either chunk or feature"),
    ):
        assert main([*words, "--set", wrong]) == 2
        assert why in capsys.readouterr().err
    given = ["--set", "camera_encoder.chunk=CounterValue", "--set", "camera_encoder.mm_per_count=0.05"]
    assert main([*words, "--set", "encoder.kind=camera", *given]) == 0
    state = CommissionState(plant)
    project = tomllib.loads(project_text.format_project(plant, state.settings))
    assert project["encoder"] == {"kind": "camera"}
    assert project["cameras"]["encoder"] == {"chunk": "CounterValue", "mm_per_count": 0.05}
    assert project["cameras"]["devices"] == {"cam0": "192.168.10.11"}


def test_assignments_are_toml_values_or_texts():
    words = [
        "core=cam1",
        "devices.cam0=192.168.10.11",
        "devices.cam1=C-2",
        "seconds=2.5",
        "board.squares=[9, 6]",
    ]
    assert parse_assignments(words, {"devices": {"cam5": "x"}}) == {
        "core": "cam1",
        "devices": {"cam5": "x", "cam0": "192.168.10.11", "cam1": "C-2"},
        "seconds": 2.5,
        "board": {"squares": [9, 6]},
    }
    with pytest.raises(SettingsError, match="KEY=VALUE"):
        parse_assignments(["core"], {})


def test_one_program_at_a_time_runs_a_step(plant):
    state = CommissionState(plant)
    state.change_settings({"source": "trial"})
    handle = lock_folder(plant)
    try:
        with pytest.raises(InputError, match="another program runs a step"):
            run(plant, "cameras")
    finally:
        os.close(handle)
    assert run(plant, "cameras")["cameras"] == 4


def test_a_command_that_fails_ends_the_step_with_its_own_line_and_the_step_stays_open(plant):
    state = CommissionState(plant)
    state.change_settings({"source": "trial"})
    run(plant, "cameras")
    CommissionState(plant).change_settings(
        {"board": {"squares": [12, 9], "square_mm": 20.0, "marker_mm": 30.0}}
    )
    with pytest.raises(InputError, match="marker"):
        run(plant, "board")
    assert get_status(CommissionState(plant), find_step("board")) == "open"


def test_the_tables_of_cameras_are_those_that_record_reads(plant):
    state = CommissionState(plant)
    devices = {"cam0": "192.168.10.11", "left cam": "Basler-21730563"}
    state.change_settings({"source": "cameras", "devices": devices, "exposure_us": 800, "trigger": "line"})
    (plant / "cameras.toml").write_text(project_text.format_cameras(state.settings))
    cameras = read_recording_project(plant / "cameras.toml").cameras
    assert (cameras.devices, cameras.exposure_us, cameras.trigger) == (devices, 800, "line")
    state.change_settings(
        {"density_kg_m3": 1600, "encoder": {"kind": "udp", "port": 8461}, "plant": 'Belt "3"'}
    )
    (plant / "project.toml").write_text(project_text.format_project(plant, state.settings))
    project = read_toml(plant / "project.toml")
    assert project["cameras"]["devices"] == devices
    assert (project["name"], project["encoder"]["kind"], project["density"]["kg_m3"]) == (
        'Belt "3"',
        "udp",
        1600,
    )
    assert list_commands(state, "empty")[0][:2] == ("record", "cameras.toml")


def test_changed_answers_reach_project_toml_unless_somebody_has_changed_it(plant, monkeypatch):
    monkeypatch.setattr(StepRun, "call_all", lambda *_: {"parts": {}})
    state = CommissionState(plant)
    devices = {"cam0": "192.168.10.11", "cam1": "192.168.10.12"}
    state.change_settings({"source": "cameras", "devices": devices, "exposure_us": 1000, "load_mm": 300})
    for step in STEPS[:8]:
        for name in step.outputs:
            (plant / name).parent.mkdir(exist_ok=True)
            (plant / name).write_text("{}")
        state.finish(step.name, {}, ())
    notes = Silent()
    project_text.write_cameras(state)
    with monkeypatch.context() as refusing:
        refusing.setattr(StepRun, "call_all", lambda *_: (_ for _ in ()).throw(InputError("a port is taken")))
        with pytest.raises(InputError, match="port"):
            StepRun(state, notes).run("project")  # what it wrote stays, to be mended by hand or by answers
    state.change_settings({"load_mm": 400})
    StepRun(state, notes).run("project")
    assert get_status(state, find_step("project")) == "done"
    state.change_settings({"exposure_us": 800})
    project_text.write_cameras(state)  # as the step of the pictures does
    assert get_status(state, find_step("project")) == "outdated"
    StepRun(state, notes).run("project")
    assert (get_status(state, find_step("project")), notes.warnings) == ("done", [])
    assert read_toml(plant / "project.toml")["cameras"]["exposure_us"] == 800
    own = (plant / "project.toml").read_text().replace("load_mm = 400.0", "load_mm = 500.0") + "# mine\n"
    (plant / "project.toml").write_text(own)
    state.change_settings({"exposure_us": 600})
    StepRun(state, notes).run("project")
    assert (plant / "project.toml").read_text() == own
    assert [line.split(";")[0] for line in notes.warnings] == [
        "project.toml: cameras.exposure_us is 800.0, 600.0 was answered",
        "project.toml: matching.load_mm is 500.0, 400.0 was answered",
    ]


def test_a_damaged_state_is_refused_with_its_file(plant, capsys):
    plant.mkdir()
    (plant / FILE).write_text('{"format": "something else"}')
    assert main(["commission", str(plant), "--list"]) == 2
    assert FILE in capsys.readouterr().err
