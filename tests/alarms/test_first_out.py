"""First-out: the alarm of a group whose condition began first is marked until the group is clear."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.management import FirstOut, GroupMember, find_group
from beltscape.alarms.settings import AlarmSettings
from beltscape.core.alarm_catalogue import GROUPS
from tests.alarms.plant import BAD, GOOD, Plant, camera

LOST: dict[str, Any] = {"cameras": {"cam2": camera(state="lost", message="silent"), "cam3": camera("cam3")}}


def first(plant):
    return [alarm.name for alarm in plant.board.alarms if alarm.is_first]


def test_the_cause_is_marked_and_not_its_consequences():
    plant = Plant()
    plant.run(GOOD, 5)
    plant.run(replace(GOOD, **LOST), 3)
    assert first(plant) == ["camera_lost:cam2"]
    plant.run(replace(GOOD, **LOST, coverage=0.3), 30)
    assert first(plant) == ["camera_lost:cam2"]
    assert plant.states()["low_coverage"] == "raised"
    plant.board.acknowledge("camera_lost:cam2", "ada", 1)
    plant.run(replace(GOOD, coverage=0.3), 30)  # the cause ends first: its consequence inherits nothing
    assert first(plant) == []
    plant.run(GOOD, 30)
    plant.board.acknowledge("low_coverage", "ada", 1)
    plant.run(replace(GOOD, coverage=0.3), 30)  # a new chain
    assert first(plant) == ["low_coverage"]


def test_a_cause_with_a_longer_delay_is_still_the_first():
    plant = Plant(AlarmSettings.model_validate({"camera_lost": {"after_s": 20}}))
    plant.run(GOOD, 5)
    plant.run(replace(GOOD, **LOST), 4)
    plant.run(replace(GOOD, **LOST, coverage=0.3), 12)
    assert first(plant) == ["low_coverage"]
    plant.run(replace(GOOD, **LOST, coverage=0.3), 12)
    assert first(plant) == ["camera_lost:cam2"]


def test_groups_are_independent():
    plant = Plant()
    plant.run(GOOD, 5)
    plant.run(replace(GOOD, **LOST, **BAD["overload"]), 10)
    assert first(plant) == ["overload", "camera_lost:cam2"]


def test_a_tie_goes_to_the_cause():
    members = [
        GroupMember(name, "images", find_group(name, GROUPS)[1], 5) for name in ("low_coverage", "lamp")
    ]
    for order in (members, members[::-1]):
        first_out = FirstOut()
        first_out.update(order)
        assert (first_out.has("lamp"), first_out.has("low_coverage")) == (True, False)


STEPS = st.lists(st.sets(st.integers(0, 5), max_size=6), max_size=30)


@given(STEPS)
def test_a_chain_has_one_first_and_it_stays_while_later_ones_come(steps):
    first_out, onset, before, first = FirstOut(), {}, set(), set()
    for now, present in enumerate(steps):
        onset |= dict.fromkeys(present - before, now)
        first_out.update([GroupMember(str(one), "g", one, onset[one]) for one in present])
        marked = {one for one in range(6) if first_out.has(str(one))}
        assert len(marked) == (1 if present else 0)
        if present and before:
            assert marked == first  # whether it is still present or not
        first, before = marked, present
