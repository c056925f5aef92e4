"""Alarms that must be reset: the states E and F of ANSI/ISA-18.2."""

from __future__ import annotations

from dataclasses import replace

from beltscape.alarms.settings import AlarmSettings
from tests.alarms.plant import BAD, GOOD, Plant

HEAVY = replace(GOOD, **BAD["overload"])
SETTINGS = AlarmSettings.model_validate({"overload": {"needs_reset": True}})


def get(plant):
    alarm = plant.board.get("overload")
    assert alarm is not None
    return alarm


def isa_state(plant):
    return get(plant).isa_state


def test_states_from_unacknowledged_over_latched_to_normal():
    plant = Plant(SETTINGS)
    plant.run(HEAVY, 10)
    assert isa_state(plant) == "unacknowledged"
    plant.run(GOOD, 20)
    assert isa_state(plant) == "latched_unacknowledged"
    assert not plant.board.reset("overload")
    assert plant.board.acknowledge("overload", "ada", 1)
    assert (isa_state(plant), get(plant).by) == ("latched_acknowledged", "ada")
    assert not plant.board.acknowledge("overload", "ada", 1)
    assert plant.board.reset("overload") and not plant.board.reset("overload")
    assert isa_state(plant) == "normal"


def test_an_acknowledged_alarm_latches_when_its_condition_ends_and_is_raised_again():
    plant = Plant(SETTINGS)
    plant.run(HEAVY, 10)
    plant.board.acknowledge("overload", "ada", 1)
    assert not plant.board.reset("overload")
    (latched,) = plant.run(GOOD, 20)
    assert (latched.state, latched.by) == ("latched", "ada")
    (raised,) = plant.run(HEAVY, 10)
    assert (raised.state, raised.by) == ("raised", "")


def test_without_the_setting_nothing_latches():
    plant = Plant()
    plant.run(HEAVY, 10)
    plant.run(GOOD, 20)
    assert isa_state(plant) == "returned_unacknowledged"
    assert plant.board.acknowledge("overload", "ada", 1)
    assert isa_state(plant) == "normal"
