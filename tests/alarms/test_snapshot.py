"""Alarms over a restart: the states of a board continue in another one, as if the program had run all the time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.settings import AlarmSettings
from beltscape.alarms.snapshot import format_snapshot, parse_snapshot
from beltscape.core.alarms import Alarm, Suppression
from beltscape.core.translatable_message import Message, get_key, get_values
from tests.alarms.plant import BAD, GOOD, SETTINGS, Plant, camera

OVERLOADED = replace(GOOD, **BAD["overload"])
CAMERAS = ("cam2", "cam3")


def restart(plant: Plant, settings: AlarmSettings = SETTINGS, cameras: tuple[str, ...] = CAMERAS) -> Plant:
    """Return a plant whose board continues from the bytes that the other one leaves."""
    again = Plant(settings)
    again.board.restore(parse_snapshot(format_snapshot(plant.board.snapshot(CAMERAS))), cameras)
    return again


def get(plant: Plant, name: str) -> Alarm:
    alarm = plant.board.get(name)
    assert alarm is not None
    return alarm


def make_settings(**overload: Any) -> AlarmSettings:
    return AlarmSettings.model_validate({"overload": overload})


def test_an_acknowledged_alarm_stays_acknowledged_and_ends_without_another() -> None:
    plant = Plant()
    plant.run(OVERLOADED, 5)
    plant.board.acknowledge("overload", "ada", 77)
    before = get(plant, "overload")
    again = restart(plant)
    assert get(again, "overload") == before
    again.run(OVERLOADED, 30)
    after = get(again, "overload")
    assert (after.state, after.by, after.acknowledged_ns, after.since_ns) == (
        "acknowledged", "ada", 77, before.since_ns,
    )  # fmt: skip
    again.run(GOOD, 30)
    assert again.states()["overload"] == "clear"


def test_what_ended_while_the_program_was_away_waits_for_its_acknowledgement_if_it_latches() -> None:
    for latched, state in ((True, "gone"), (False, "clear")):
        settings = make_settings(latched=latched)
        plant = Plant(settings)
        plant.run(OVERLOADED, 5)
        again = restart(plant, settings)
        again.run(GOOD, 30)
        assert again.states()["overload"] == state
    twice = restart(restart(plant, settings), settings)  # two starts without a reading between them
    assert twice.states()["overload"] == "raised"


def test_a_latched_alarm_is_reset_after_the_restart() -> None:
    settings = make_settings(needs_reset=True)
    plant = Plant(settings)
    plant.run(OVERLOADED, 5)
    plant.run(GOOD, 30)
    unacknowledged = restart(plant, settings)
    assert get(unacknowledged, "overload").isa_state == "latched_unacknowledged"
    assert unacknowledged.board.acknowledge("overload", "ada", 5)  # before any reading
    latched = restart(unacknowledged, settings)
    assert (get(latched, "overload").isa_state, get(latched, "overload").by) == (
        "latched_acknowledged",
        "ada",
    )
    assert latched.board.reset("overload") and latched.states()["overload"] == "clear"
    assert restart(latched, settings).board.alarms == ()


def test_the_first_of_a_chain_stays_the_first_also_when_it_has_ended() -> None:
    plant = Plant()
    plant.run(GOOD, 5)
    plant.run(replace(GOOD, **BAD["camera_lost:cam2"]), 4)
    plant.run(replace(GOOD, **BAD["camera_lost:cam2"], coverage=0.3), 30)
    again = restart(plant)
    assert [alarm.name for alarm in again.board.alarms if alarm.is_first] == ["camera_lost:cam2"]
    plant.board.acknowledge("camera_lost:cam2", "ada", 1)
    plant.run(replace(GOOD, coverage=0.3), 30)  # the cause has ended, its consequence inherits nothing
    later = restart(plant)
    later.run(replace(GOOD, coverage=0.3, **BAD["camera_lost:cam2"]), 30)
    assert [alarm.name for alarm in later.board.alarms if alarm.is_first] == ["camera_lost:cam2"]
    assert later.states()["low_coverage"] == "raised"


@pytest.mark.parametrize(
    ("settings", "cameras"),
    [
        (SETTINGS, ("cam3", "cam4")),
        (AlarmSettings.model_validate({"camera_lost": {"enabled": False}}), CAMERAS),
    ],
)
def test_an_alarm_of_what_is_gone_is_not_restored(settings: AlarmSettings, cameras: tuple[str, ...]) -> None:
    plant = Plant()
    plant.run(replace(GOOD, **BAD["camera_lost:cam2"]), 5)
    assert restart(plant).states()["camera_lost:cam2"] == "raised"
    assert restart(plant, settings, cameras).board.get("camera_lost:cam2") is None


def test_a_bank_that_is_gone_is_not_restored() -> None:
    plant = Plant()
    plant.run(replace(GOOD, **BAD["cameras_off"]), 5)
    banks = AlarmSettings.model_validate({"cameras_off": {"banks": {"left": ["cam2"], "right": ["cam3"]}}})
    assert "cameras_off" in restart(plant).states()
    assert "cameras_off" not in restart(plant, banks).states()


def test_suppressions_go_on_over_a_restart() -> None:
    plant = Plant()
    plant.run(replace(GOOD, **BAD["misaligned_belt"]), 10)
    plant.run(replace(GOOD, **BAD["misaligned_belt"], **BAD["belt_stopped"]), 5)
    again = restart(plant)
    assert get(again, "misaligned_belt").isa_state == "suppressed_by_design"
    again.run(replace(GOOD, **BAD["misaligned_belt"]), 3)
    assert again.states()["misaligned_belt"] == "raised"  # from before the stop: it goes on
    plant = Plant()
    plant.run(replace(GOOD, **BAD["belt_stopped"]), 5)
    plant.run(replace(GOOD, **BAD["misaligned_belt"], **BAD["belt_stopped"]), 20)
    again = restart(plant)  # it came during the stop: it must prove itself
    assert "misaligned_belt" not in again.states()


def test_an_alarm_that_a_person_hides_is_shown_unacknowledged_afterwards() -> None:
    plant = Plant()
    plant.run(OVERLOADED, 5)
    plant.board.acknowledge("overload", "ada", 1)
    plant.board.hide({"overload": Suppression("shelved", "test", "ada", 1, 2)})
    again = Plant()
    again.board.hide({"overload": Suppression("shelved", "test", "ada", 1, 2)})
    again.board.restore(plant.board.snapshot())
    assert (get(again, "overload").state, get(again, "overload").hidden_state) == ("clear", "acknowledged")
    again.board.hide({})
    assert get(again, "overload").state == "raised"


def test_a_text_keeps_the_parts_of_its_translation() -> None:
    plant = Plant()
    lost = camera(state="lost", message=Message("no image for 3.5 s", "silent", time=3.5, camera="cam2"))
    plant.run(replace(GOOD, cameras={"cam2": lost, "cam3": camera("cam3")}), 5)
    detail = get(restart(plant), "camera_lost:cam2").detail
    assert (detail, get_key(detail), get_values(detail)) == (
        "no image for 3.5 s", "silent", {"time": 3.5, "camera": "cam2"},
    )  # fmt: skip


@given(st.data())
def test_a_board_that_is_restarted_at_random_is_in_the_same_states(data: st.DataObject) -> None:
    """Delays begin anew at a restart; without delays a restart changes nothing at all."""
    instant = {"after_s": 0, "clear_after_s": 0, "after_mm": 0, "clear_after_mm": 0}
    settings = AlarmSettings.model_validate({
        "overload": {**instant, "needs_reset": data.draw(st.booleans()), "latched": data.draw(st.booleans())},
        "disk_full": {"after_s": 0, "clear_after_s": 0},
    })  # fmt: skip
    plain, restarted = Plant(settings), Plant(settings)
    for step in range(data.draw(st.integers(1, 12))):
        names = data.draw(st.sets(st.sampled_from(["overload", "disk_full"])))
        readings = replace(GOOD, **{key: value for name in names for key, value in BAD[name].items()})
        act = data.draw(st.sampled_from(["", "acknowledge", "reset", "restart"]))
        if act == "restart":
            second = restarted.second
            restarted = restart(restarted, settings)
            restarted.second = second
        for plant in (plain, restarted):
            plant.run(readings, 1)
            if act == "acknowledge":
                plant.board.acknowledge("overload", "ada", step)
            if act == "reset":
                plant.board.reset("overload")
        present = [
            [
                (a.name, a.state, a.by, a.acknowledged_ns, a.since_ns)
                for a in plant.board.alarms
                if a.state != "clear"
            ]
            for plant in (plain, restarted)
        ]
        assert present[0] == present[1]
