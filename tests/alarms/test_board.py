"""The board of alarms: every rule is raised, acknowledged and cleared by its readings."""

from __future__ import annotations

import itertools
from dataclasses import replace
from threading import Thread

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.board import AlarmBoard
from beltscape.alarms.readings import Readings
from beltscape.alarms.rules import RULES
from beltscape.alarms.settings import AlarmSettings
from beltscape.alarms.texts import TEXTS
from beltscape.core.errors import InputError
from beltscape.files.toml_text import validate
from tests.alarms.plant import BAD, GOOD, SECOND, SETTINGS, Plant
from tests.strategies import floats
from tests.thorough import THOROUGH

LONG_S = 150
"""Longer than every delay: 120 s of what is measured seldom, and 10 s until it is clear again."""
SELDOM_S = 1 if THOROUGH else 5
"""Time between two updates of the long runs."""


def test_every_rule_has_settings_a_text_and_a_case():
    kinds = {name.partition(":")[0] for name in BAD}
    others = {"faults", "checks", "priorities", "groups", "suppression", "shelving", "texts"}
    assert set(RULES) == set(AlarmSettings.model_fields) - others == set(TEXTS) == kinds


def test_all_alarms_are_clear_with_good_readings():
    plant = Plant()
    assert plant.run(GOOD, LONG_S, SELDOM_S) == []
    assert set(plant.states().values()) == {"clear"}
    assert set(plant.states()) == set(BAD) | {"camera_lost:cam3"}


@pytest.mark.parametrize("name", BAD)
def test_every_alarm_is_raised_alone_and_clears(name):
    plant = Plant()
    plant.run(GOOD, 5)
    (raised,) = plant.run(replace(GOOD, **BAD[name]), LONG_S, SELDOM_S)
    assert (raised.name, raised.state) == (name, "raised")
    assert raised.since_ns is not None
    assert raised.detail
    assert "{" not in raised.detail
    assert "\n" not in raised.detail
    over = plant.run(GOOD, LONG_S, SELDOM_S)
    kind = name.partition(":")[0]
    latched = getattr(SETTINGS, kind).latched
    assert [alarm.state for alarm in over] == ["gone" if latched else "clear"]
    assert plant.board.acknowledge(name, "ada", 1) == latched
    assert set(plant.states().values()) == {"clear"}


@pytest.mark.parametrize("name", BAD)
def test_every_alarm_can_be_acknowledged_while_it_lasts(name):
    plant = Plant()
    plant.run(GOOD, 5)
    plant.run(replace(GOOD, **BAD[name]), LONG_S, SELDOM_S)
    assert plant.board.acknowledge(name, "ada", 1)
    assert not plant.board.acknowledge(name, "bob", 1)
    assert plant.run(replace(GOOD, **BAD[name]), 100, SELDOM_S) == []
    (alarm,) = [one for one in plant.board.alarms if one.state != "clear"]
    assert (alarm.name, alarm.state, alarm.by) == (name, "acknowledged", "ada")
    (over,) = plant.run(GOOD, LONG_S, SELDOM_S)
    assert (over.state, over.by, over.detail) == ("clear", "", "")


@pytest.mark.parametrize("name", [name for name in BAD if not name.startswith("no_measurement")])
def test_unknown_readings_neither_raise_nor_clear(name):
    kind = name.partition(":")[0]
    settings = AlarmSettings.model_validate({**SETTINGS.model_dump(), "no_measurement": {"enabled": False}})
    plant = Plant(settings)
    plant.run(Readings(), LONG_S, SELDOM_S)
    assert set(plant.states().values()) == {"clear"}
    plant.run(replace(GOOD, **BAD[name]), LONG_S, SELDOM_S)
    before = plant.states()
    assert before[name] == "raised"
    assert plant.run(Readings(), LONG_S, SELDOM_S) == []
    assert plant.states() == before
    assert kind in RULES


def test_missing_load_is_raised_from_the_start_and_suppresses_the_rest():
    plant = Plant()
    assert plant.run(Readings(), 60) == []
    changed = plant.run(Readings(), 600, SELDOM_S)
    assert [alarm.name for alarm in changed] == ["no_measurement:load"]


def test_one_cause_raises_one_alarm():
    plant = Plant()
    plant.run(GOOD, 5)
    changed = plant.run(Readings(), LONG_S, SELDOM_S)
    assert [alarm.name for alarm in changed] == ["no_measurement:load"]


def test_disabled_alarm_is_absent():
    settings = AlarmSettings.model_validate({name: {"enabled": False} for name in RULES})
    plant = Plant(settings)
    for wrong in BAD.values():
        assert plant.run(replace(GOOD, **wrong), 100, SELDOM_S) == []
    assert plant.board.alarms == ()


def test_system_clock_may_jump():
    one, two = AlarmBoard(SETTINGS), AlarmBoard(SETTINGS)
    walls = itertools.cycle([0, 10**19, -(10**18)])
    for second in range(100):
        readings = replace(GOOD, **BAD["overload"]) if second % 40 < 20 else GOOD
        first = one.update(readings, second, second * SECOND)
        second_ = two.update(readings, next(walls), second * SECOND)
        assert [(a.name, a.state) for a in first] == [(a.name, a.state) for a in second_]


BANDS = [
    ("overload", "area_mm2", 9.51e4, 1.009e5),  # limit 1e5 and σ 1e3, clear at 9.5e4
    ("belt_stopped", "speed_mm_s", 20, 39.9),
    ("misaligned_belt", "belt_offset_mm", 35.1, 51.9),
    ("misaligned_belt", "belt_offset_mm", -51.9, -35.1),
    ("low_coverage", "coverage", 0.6, 0.659),
    ("oversize_lump", "largest_lump_mm", 190.1, 200),
    ("frames_dropped", "dropped_per_minute", 3.1, 6),
    ("encoder_silent", "encoder_silent_s", 1.01, 2),
    ("certificate_expiring", "certificate_days", 30, 31.4),
]


@given(st.sampled_from(BANDS), st.booleans(), st.booleans(), st.data())
def test_no_state_changes_within_the_band(band, wrong, seen, data):
    """From either side, acknowledged or not, whatever the value does in there."""
    name, field, low, high = band
    plant = Plant()
    plant.run(GOOD, 2)
    if wrong:
        plant.run(replace(GOOD, **BAD[name]), 15)
        assert not seen or plant.board.acknowledge(name, "ada", 0)
    before = plant.states()
    assert (before[name] == "clear") != wrong
    for value in data.draw(st.lists(floats(low, high), min_size=1, max_size=12)):
        assert plant.run(replace(GOOD, **{field: value}), 6) == []
    assert plant.states() == before


SITUATIONS = st.lists(st.tuples(st.sampled_from([{}, *BAD.values()]), st.integers(1, 20)), max_size=8)


@given(SITUATIONS)
def test_alarms_are_independent(situations):
    """What one alarm does, alone on the board or among all others, is the same where none suppresses another."""
    shown = {"suppression": {"belt_stopped": [], "cameras_off": [], "frames_dropped": []}}
    every = Plant(AlarmSettings.model_validate({**SETTINGS.model_dump(), **shown}))
    kinds = ("overload", "belt_stopped", "camera_lost", "encoder_silent")
    off = {kind: {"enabled": False} for kind in RULES}
    alone = [
        Plant(AlarmSettings.model_validate({**off, kind: getattr(SETTINGS, kind).model_dump()}))
        for kind in kinds
    ]
    for wrong, seconds in situations:
        for plant in (every, *alone):
            plant.run(replace(GOOD, **wrong), seconds)
        states = every.states()
        for plant in alone:
            assert plant.states().items() <= states.items()


@given(SITUATIONS, st.integers(1, 5))
def test_returned_changes_match_the_states(situations, seconds):
    plant = Plant()
    changes = {}
    for wrong, _ in situations:
        changes |= {alarm.name: alarm for alarm in plant.run(replace(GOOD, **wrong), seconds)}
        assert {name: state for name, state in plant.states().items() if state != "clear"} == {
            name: alarm.state for name, alarm in changes.items() if alarm.state != "clear"
        }


def test_any_thread_may_read_and_acknowledge():
    plant = Plant()
    done = []
    reading = Thread(target=lambda: done.extend(len(plant.board.alarms) for _ in range(300)))
    acknowledging = Thread(
        target=lambda: done.extend(plant.board.acknowledge("overload", "ada", 0) for _ in range(300))
    )
    for thread in (reading, acknowledging):
        thread.start()
    for _ in range(20):
        plant.run(replace(GOOD, **BAD["overload"]), 5)
        plant.run(GOOD, 10)
    for thread in (reading, acknowledging):
        thread.join()
    assert len(done) == 600


def test_unknown_key_is_refused_with_the_nearest(tmp_path):

    with pytest.raises(InputError, match="did you mean speed_mm_s"):
        validate(tmp_path / "project.toml", AlarmSettings, {"belt_stopped": {"sped_mm_s": 3}})
