"""Suppression by design, shelving and out-of-service: evaluated, but not shown."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from beltscape.alarms.board import AlarmBoard
from beltscape.alarms.settings import AlarmSettings
from beltscape.core.alarms import Suppression
from beltscape.core.events import Capacity
from tests.alarms.plant import BAD, GOOD, NAN, SETTINGS, Plant, camera

STOPPED = replace(GOOD, speed_mm_s=0.0)
UNLOADED: dict[str, Any] = {"area_mm2": NAN, "volume_flow_m3_h": NAN, "mass_flow_t_h": NAN}
SHELVED = {"overload": Suppression("shelved", "scale under test", "ada", 1, 2)}


def get(plant, name):
    alarm = plant.board.get(name)
    assert alarm is not None
    return alarm


def test_a_stopped_belt_suppresses_what_it_explains_and_shows_itself():
    plant = Plant()
    plant.run(GOOD, 5)
    assert [a.name for a in plant.run(replace(STOPPED, **UNLOADED), 60)] == ["belt_stopped"]
    hidden = get(plant, "no_measurement:load")
    assert (hidden.state, hidden.hidden_state, hidden.isa_state) == (
        "clear",
        "raised",
        "suppressed_by_design",
    )
    assert hidden.suppression is not None and hidden.suppression.reason == "belt_stopped"
    assert hidden.detail and not hidden.is_listed
    # the belt runs again: the load is measured before the alarm's own delay has passed
    changed = plant.run(replace(GOOD, **UNLOADED), 9) + plant.run(GOOD, 60)
    assert [(a.name, a.state) for a in changed] == [("belt_stopped", "clear")]


def test_what_still_holds_after_the_stop_is_raised_after_its_delay():
    plant = Plant()
    plant.run(GOOD, 5)
    plant.run(replace(STOPPED, **UNLOADED), 60)
    changed = plant.run(replace(GOOD, **UNLOADED), 14)
    assert [(a.name, a.state) for a in changed] == [
        ("belt_stopped", "clear"),
        ("no_measurement:load", "raised"),
    ]


@pytest.mark.parametrize("acknowledge", [True, False])
def test_an_alarm_from_before_goes_on_after_the_suppression(acknowledge):
    plant = Plant()
    plant.run(GOOD, 5)
    plant.run(replace(GOOD, coverage=0.4), 30)
    assert not acknowledge or plant.board.acknowledge("low_coverage", "ada", 1)
    before = plant.states()["low_coverage"]
    plant.run(replace(STOPPED, coverage=0.4), 30)
    assert plant.states()["low_coverage"] == "clear"
    assert not plant.board.acknowledge("low_coverage", "bob", 1)
    plant.run(replace(GOOD, coverage=0.4), 5)
    assert plant.states()["low_coverage"] == before


def test_cameras_off_replaces_the_alarms_of_its_cameras():
    plant = Plant()
    plant.run(GOOD, 5)
    changed = plant.run(replace(GOOD, **BAD["cameras_off"], **UNLOADED), 60)
    assert [a.name for a in changed] == ["cameras_off"]
    assert {a.name for a in plant.board.alarms if a.hidden_state == "raised"} == {
        "camera_lost:cam2", "camera_lost:cam3", "no_measurement:load",
    }  # fmt: skip
    assert {state for name, state in plant.states().items() if name.startswith("camera_lost")} == {"clear"}
    assert [(a.name, a.state) for a in plant.run(GOOD, 30)] == [("cameras_off", "gone")]


def test_one_bank_off_leaves_the_alarms_of_the_other():
    banks = {"left": ["cam0", "cam1"], "right": ["cam2", "cam3"]}
    plant = Plant(AlarmSettings.model_validate({"cameras_off": {"banks": banks}}))
    cameras = {f"cam{i}": camera(f"cam{i}") for i in range(4)}
    lost = {name: camera(name, state="lost", message="silent") for name in ("cam0", "cam1", "cam2")}
    plant.run(replace(GOOD, cameras=cameras), 5)
    changed = plant.run(replace(GOOD, cameras={**cameras, **lost}), 60)
    assert {a.name for a in changed} == {"cameras_off:left", "camera_lost:cam2"}


def test_unusable_images_are_no_bank_that_is_off():
    plant = Plant()
    plant.run(GOOD, 5)
    dark = {name: camera(name, state="unusable", message="dark") for name in ("cam2", "cam3")}
    assert {a.name for a in plant.run(replace(GOOD, cameras=dark), 30)} == {
        "camera_lost:cam2",
        "camera_lost:cam3",
    }


def test_a_shelved_alarm_is_evaluated_but_not_shown():
    plant = Plant()
    plant.run(GOOD, 5)
    plant.board.hide(SHELVED)
    heavy = replace(GOOD, **BAD["overload"])
    assert plant.run(heavy, 10) == []
    alarm = get(plant, "overload")
    assert (alarm.state, alarm.hidden_state, alarm.isa_state, alarm.is_listed) == (
        "clear",
        "raised",
        "shelved",
        True,
    )
    assert alarm.suppression == SHELVED["overload"]
    (hidden,) = [a.name for a, _ in plant.run_all(GOOD, 20)]  # its change is journalled
    assert hidden == "overload"


@pytest.mark.parametrize(
    ("readings", "state"), [(replace(GOOD, **BAD["overload"]), "raised"), (GOOD, "clear")]
)
def test_after_shelving_it_is_unacknowledged_where_it_holds(readings, state):
    plant = Plant()
    plant.run(replace(GOOD, **BAD["overload"]), 10)
    plant.board.acknowledge("overload", "ada", 1)
    plant.board.hide(SHELVED)
    assert plant.states()["overload"] == "clear"
    plant.run(readings, 20)
    plant.board.hide({})
    assert plant.states()["overload"] == state


def test_out_of_service_stands_before_a_state_and_meets_alarms_that_come_later():
    board = AlarmBoard(SETTINGS)
    board.hide({"camera_lost:cam2": Suppression("out_of_service", "sent for repair", "eve", 1)})
    lost = {"cam2": camera(state="lost", message="silent"), "cam3": camera("cam3")}
    plant = Plant()
    plant.board = board
    assert plant.run(replace(GOOD, cameras=lost), 30) == []
    assert get(plant, "camera_lost:cam2").isa_state == "out_of_service"
    plant.run(replace(GOOD, cameras=lost, is_maintained=True), 5)
    assert get(plant, "camera_lost:cam2").isa_state == "out_of_service"


def test_groups_and_suppressions_name_alarms_that_exist():
    for table in (
        {"suppression": {"belt_stopped": ["emtpy"]}},
        {"groups": {"a": ["emtpy"]}},
        {"priorities": {"emtpy": "low"}},
    ):
        with pytest.raises(ValueError, match="did you mean empty"):
            AlarmSettings.model_validate(table)
    with pytest.raises(ValueError, match="is in 'a' and in 'b'"):
        AlarmSettings.model_validate({"groups": {"a": ["empty"], "b": ["empty"]}})


def test_dropped_frames_hide_what_they_explain_and_name_it():
    plant = Plant()
    plant.run(GOOD, 5)
    starved: dict[str, Any] = {
        **UNLOADED,
        "dropped_per_minute": 90.0,
        "encoder_silent_s": 4.0,
        "coverage": 0.2,
    }
    lost = {**GOOD.cameras, "cam2": camera(state="lost")}
    plant.run(replace(GOOD, cameras=lost, **starved), 60)
    shown = {name for name, state in plant.states().items() if state == "raised"}
    assert shown == {"frames_dropped", "camera_lost:cam2"}  # what drops do not explain stays
    cause = get(plant, "frames_dropped")
    assert set(cause.consequences) == {"no_measurement:load", "encoder_silent", "low_coverage"}
    assert cause.priority == "high"
    assert cause.detail == "90.0 /min, limit 6.00 /min: lower the frame rate or choose a faster preset"


def test_dropped_frames_say_what_the_computer_measures():
    plant = Plant()
    plant.run(replace(GOOD, dropped_per_minute=90.0, capacity=Capacity(1.234, 411.0)), 60)
    assert get(plant, "frames_dropped").detail == (
        "90 frame sets a minute are left out: this computer measures 1.2 a second, which is enough for a belt of up "
        "to 0.41 m/s; choose a faster preset, smaller images or more cores"
    )
