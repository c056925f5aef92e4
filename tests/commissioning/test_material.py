"""The material test of a commissioning: zero over whole turns and runs from the plant's records, kept at once."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from beltscape.commissioning import trial
from beltscape.commissioning.material import count_turns, find_zero_records, write_test
from beltscape.commissioning.runner import StepRun
from beltscape.commissioning.session import CommissionSession, StepProgress
from beltscape.commissioning.state import CommissionState, RunAnswer, ZeroAnswer
from beltscape.commissioning.steps import STEPS, find_step, get_status
from beltscape.core.errors import InputError, SettingsError
from beltscape.core.progress import Silent
from beltscape.files.toml_text import read_toml
from tests.pipeline.certifying.plants import BEGIN_NS, BELT_M, SimulatedPlant

RECORD = timedelta(milliseconds=200)
LOADS = ("half", "full", "half", "full", "half", "full")


def moment(number: int) -> datetime:
    """Return when the record of a number was written."""
    return datetime.fromtimestamp(BEGIN_NS * 1e-9, UTC) + number * RECORD


@pytest.fixture
def plant(tmp_path) -> tuple[CommissionState, SimulatedPlant, list[dict]]:
    """A plant up to its live test, with records of four turns of empty belt and of six runs; and their answers."""
    simulated = SimulatedPlant(tmp_path / "plant")
    simulated.add_zero(4)
    runs = []
    for load in LOADS:
        first = len(simulated.records) + 1
        mass_kg = simulated.add_run(load)
        times = moment(first) - RECORD / 2, moment(len(simulated.records)) + RECORD / 2
        runs.append(
            {"load": load, "mass_kg": mass_kg, "begin": times[0].isoformat(), "end": times[1].isoformat()}
        )
    simulated.write_history()
    state = CommissionState(simulated.folder)
    state.change_settings(
        {"source": "captures", "captures": ".", "reference": {"name": "scale", "sigma_percent": 0.05}}
    )
    for step in STEPS[:-2]:
        for name in step.outputs:
            path = simulated.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                path.write_text("{}")
        state.finish(step.name, {}, ())
    return state, simulated, runs


def test_zero_and_loads_of_the_running_records_become_a_certificate(plant):
    state, simulated, runs = plant
    zero = {"revolutions": 3, "belt_length_m": BELT_M, "begin": (moment(20) - RECORD / 2).isoformat()}
    state.change_settings({"zero": zero, "runs": runs, "operator": "eva"})
    again = CommissionState(simulated.folder)  # the process was killed: another one goes on
    result = StepRun(again, Silent()).run("material")
    assert "no_zero" not in result["notes"]
    document = json.loads((simulated.folder / "test/test.json").read_text())
    written = read_toml(simulated.folder / "material_test.toml")
    first, last = written["zero"]["records"]
    assert (first, last) == (20, 20 + 3 * 100 - 1), "three turns of 40 m in records of 0.4 m"
    assert [run["load"] for run in written["runs"]] == list(LOADS)
    for error in result["errors"]:
        assert abs(error["value"] + 1.5) < 4 * error["sigma"] + 0.5, "the plant measures 1.5 % too little"
    assert document["zero"] is not None
    result = StepRun(again, Silent()).run("certificate")
    assert Path(result["page"]).is_file() or (simulated.folder / result["page"]).is_file()
    assert get_status(CommissionState(simulated.folder), find_step("certificate")) == "done"


def test_the_zero_ends_after_whole_turns_and_says_how_many_have_passed(plant):
    state, simulated, _ = plant
    data = simulated.folder / "data"
    zero = ZeroAnswer(revolutions=2, belt_length_m=BELT_M, begin=moment(1) - RECORD / 2)
    assert find_zero_records(data, zero) == (1, 200)
    turns = count_turns(data, zero)
    assert turns is not None
    assert turns > 4
    late = zero.model_copy(update={"begin": moment(len(simulated.records) - 49) - RECORD / 2})
    with pytest.raises(InputError, match=r"has turned 0\.50 of 2 times"):
        find_zero_records(data, late)
    with pytest.raises(InputError, match="nothing: does not exist"):
        find_zero_records(data / "nothing", zero)
    assert count_turns(data / "nothing", zero) is None
    assert count_turns(data, zero.model_copy(update={"belt_length_m": None})) is None
    session = CommissionSession(state)
    assert session.take_snapshot()["turns"] is None
    session.change_settings({"zero": {"belt_length_m": BELT_M, "begin": moment(1).isoformat()}})
    assert session.take_snapshot()["turns"] > 4


def test_what_is_missing_is_named(plant):
    state, _, runs = plant
    for changes, said in (
        ({"runs": runs[:1]}, "runs: give two runs or more"),
        (
            {"runs": [runs[0], {"load": "full", "mass_kg": 5}]},
            r"runs: 2 \(full\): give its capture, or begin and end",
        ),
        (
            {"runs": [runs[0], {"load": "full", "capture": "full_1"}]},
            r"runs: 2 \(full\): give its mass_kg or volume",
        ),
        ({"runs": runs, "zero": {"begin": runs[0]["begin"]}}, "zero.belt_length_m"),
    ):
        state.change_settings(changes)
        with pytest.raises(SettingsError, match=said):
            write_test(state)
    for wrong, said in (
        ({"zero": {"begin": runs[1]["begin"], "end": runs[0]["begin"]}}, "begin must be before end"),
        ({"zero": {"begin": runs[1]["begin"], "capture": "x"}}, "give either a capture"),
    ):
        with pytest.raises(SettingsError, match=said):
            state.change_settings(wrong)


def test_now_is_the_present_moment_and_on_the_disk_at_once(plant):
    state, simulated, _ = plant
    before = datetime.now(UTC) - timedelta(milliseconds=1)
    state.change_settings(
        {"zero": {"belt_length_m": BELT_M, "begin": "now"}, "runs": [{"load": "half", "begin": "now"}]}
    )
    again = CommissionState(simulated.folder).settings
    for begin in (again.zero.begin, again.runs[0].begin):
        assert begin is not None
        assert before <= begin <= datetime.now(UTC)
    state.change_settings({"operator": "eva"})
    assert CommissionState(simulated.folder).settings.zero == again.zero


def test_a_run_of_the_trial_plant_s_own_loads_has_their_truth_and_any_other_its_answer(tmp_path):
    state = CommissionState(tmp_path)
    for capture in (None, "trial/heap_1", "mine/rocks_1"):
        run = RunAnswer.model_validate({"load": "rocks", "capture": capture, "volume_m3": 0.5})
        assert trial.compute_true_m3(state, run) == 0.5


def test_the_page_shows_the_first_warnings_and_that_there_are_more() -> None:
    progress = StepProgress()
    for number in [*range(40), *range(40)]:
        progress.warn(f"frame {number}: the same image again")
    assert len(progress.warnings) == 21
    assert progress.warnings[19] == "frame 19: the same image again"
    assert "in the terminal" in progress.warnings[20]
