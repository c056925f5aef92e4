"""A commissioning that changes its cameras: results of the former ones are set aside, and do not count."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from beltscape.cli.main import main
from beltscape.commissioning import former, trial
from beltscape.commissioning.runner import StepRun
from beltscape.commissioning.state import FILE, CommissionState
from beltscape.commissioning.steps import STEPS, find_missing, find_step, get_status
from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from tests.once import make_once
from tests.synthetic.small_demo import make_small_demo

MADE = ("calibration", "calibration_1", "rig", "empty", "live_test", "flow_rocks_1")
"""Folders that steps of the trial plant leave."""


@pytest.fixture
def walked(tmp_path, tmp_path_factory, monkeypatch) -> CommissionState:
    """A trial plant whose steps have left something, and captures of the engineer's own beside it."""
    demo = make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    monkeypatch.setattr(trial, "DEMO_FOLDER", demo)
    state = CommissionState(tmp_path / "plant")
    state.change_settings({"source": "trial"})
    run(state, "cameras")
    for name in MADE:
        (state.folder / name).mkdir()
        (state.folder / name / "kept").write_text(name)
    (state.folder / "project.toml").write_text("# mine")
    (state.folder / "data").mkdir()
    state.finish("material", {"errors": [], "results": []}, ())
    shutil.copytree(demo / "calibration", tmp_path / "mine/calibration")
    return state


def run(state: CommissionState, step: str) -> dict:
    return StepRun(state, Silent()).run(step)


def read_all(folder: Path) -> dict[str, str]:
    return {name: (folder / name / "kept").read_text() for name in MADE}


def test_runs_and_results_of_other_cameras_are_set_aside_by_name(walked) -> None:
    runs = walked.settings.runs
    walked.change_settings(
        {"captures": str(walked.folder.parent / "mine"), "source": "captures", "seconds": 9}
    )
    assert get_status(walked, find_step("cameras")) == "outdated"
    assert {get_status(walked, step) for step in STEPS[1:]} == {"blocked"}
    assert find_missing(walked, find_step("material")) == "cameras"
    with pytest.raises(InputError, match="finish the step cameras first"):
        run(walked, "material")
    assert run(walked, "cameras")["set_aside"] == ["former_trial"]
    kept = walked.folder / "former_trial"
    assert read_all(kept) == {name: name for name in MADE}
    assert (kept / "project.toml").read_text() == "# mine"
    assert not any((walked.folder / name).exists() for name in (*MADE, "project.toml", "trial"))
    assert (walked.folder / "data").is_dir(), "users and certificates are the plant's"
    settings = walked.settings
    assert (settings.runs, settings.board.file, settings.plant, settings.operator) == ((), None, "belt", "")
    assert settings.seconds == 9
    assert walked.get_record("material") is None
    again = CommissionState(kept)
    assert again.settings.runs == runs
    assert again.get_record("material") is not None
    assert run(again, "trigger")["incomplete"] == 0, "it can be gone on with"


def test_who_returns_to_the_former_cameras_before_the_step_loses_nothing(walked) -> None:
    before = json.loads((walked.folder / FILE).read_text())
    walked.change_settings({"source": "captures", "captures": str(walked.folder.parent / "mine")})
    walked.change_settings({"source": "trial", "captures": "trial"})
    assert json.loads((walked.folder / FILE).read_text()) == before
    assert "set_aside" not in run(walked, "cameras")
    assert read_all(walked.folder) == {name: name for name in MADE}


def test_cameras_that_cannot_be_read_set_nothing_aside(walked, capsys) -> None:
    words = ["commission", str(walked.folder), "--step", "cameras", "--set", "source=captures"]
    assert main([*words, "--set", f"captures={walked.folder.parent / 'nowhere'}"]) == 2
    assert "nowhere" in capsys.readouterr().err
    assert read_all(walked.folder) == {name: name for name in MADE}


def test_a_program_that_is_killed_goes_on_with_the_same_folder(walked, monkeypatch) -> None:
    walked.change_settings({"source": "captures", "captures": str(walked.folder.parent / "mine")})
    rename, moved = Path.rename, []

    def rename_some(path: Path, to: Path) -> Path:
        if len(moved) == 2:
            raise KeyboardInterrupt
        moved.append(path)
        return rename(path, to)

    monkeypatch.setattr(Path, "rename", rename_some)
    with pytest.raises(KeyboardInterrupt):
        run(walked, "cameras")
    monkeypatch.setattr(Path, "rename", rename)
    again = CommissionState(walked.folder)
    assert again.has_other_cameras
    assert run(again, "cameras")["set_aside"] == ["former_trial"]
    assert read_all(walked.folder / "former_trial") == {name: name for name in MADE}


def test_the_second_change_has_a_folder_of_its_own_and_a_folder_in_use_stays(walked) -> None:
    mine = walked.folder / "empty_of_ours"
    shutil.copytree(walked.folder.parent / "mine", mine)
    walked.change_settings({"source": "captures", "captures": "empty_of_ours"})
    run(walked, "cameras")
    walked.change_settings({"source": "trial"})
    run(walked, "cameras")
    walked.change_settings({"source": "captures", "captures": "empty_of_ours"})
    assert run(walked, "cameras")["set_aside"] == ["former_captures", "former_trial", "former_trial_2"]
    assert (mine / "calibration").is_dir()


def test_the_same_names_are_the_same_cameras_and_others_are_not(tmp_path) -> None:
    state = CommissionState(tmp_path)
    state.change_settings(
        {"source": "cameras", "devices": {"cam0": "192.168.10.11", "cam1": "192.168.10.12"}}
    )
    state.finish("cameras", {}, ())
    state.change_settings({"devices": {"cam1": "192.168.10.22", "cam0": "192.168.10.11"}})
    assert not state.has_other_cameras, "an address is no camera"
    state.change_settings({"devices": {"cam0": "192.168.10.11", "cam2": "192.168.10.22"}})
    assert state.has_other_cameras
    assert former.set_former_aside(state) == "former_cameras"
