"""The board of alarms: every rule is raised, acknowledged and cleared by its readings."""

from __future__ import annotations

import itertools
from dataclasses import fields, replace
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.board import AlarmBoard
from beltscape.alarms.readings import Readings
from beltscape.alarms.rules import RULES
from beltscape.alarms.settings import AlarmSettings, Fault, OversizeLump
from beltscape.alarms.texts import TEXTS
from beltscape.core.errors import InputError
from beltscape.core.findings import Finding
from beltscape.core.live import CameraHealth, CameraState
from beltscape.core.translatable_message import Message, get_key
from beltscape.files.documents.toml_text import validate
from tests.strategies import floats

NAN = float("nan")
SECOND = 1_000_000_000
SETTINGS = AlarmSettings(oversize_lump=OversizeLump(size_mm=200))


def camera(name="cam2", state: CameraState = "ok", skew_ms=0.1, message=""):
    return CameraHealth(name, state, 10, 0, 25.0, skew_ms, message)


GOOD = Readings(
    area_mm2=5e4,
    area_sigma_mm2=1e3,
    full_area_mm2=1e5,
    volume_flow_m3_h=300,
    volume_flow_sigma_m3_h=3,
    mass_flow_t_h=500,
    mass_flow_sigma_t_h=5,
    belt_mm=0,
    speed_mm_s=1500,
    coverage=0.9,
    largest_lump_mm=90,
    largest_lump_sigma_mm=9,
    belt_offset_mm=3,
    belt_offset_sigma_mm=2,
    cameras={"cam2": camera()},
    dropped_per_minute=0,
    history_trouble="",
    history_repair="",
    users_trouble="",
    recording_trouble="",
    encoder_silent_s=0.01,
    encoder_trouble="",
    certificate_days=200,
)
BAD = {
    "overload": {"area_mm2": 1.2e5},
    "empty": {"area_mm2": 500.0},
    "belt_stopped": {"speed_mm_s": 0.0},
    "oversize_lump": {"largest_lump_mm": 230.0},
    "misaligned_belt": {"belt_offset_mm": -70.0},
    "low_coverage": {"coverage": 0.4},
    "camera_lost:cam2": {"cameras": {"cam2": camera(state="lost", message="silent for 1.0 s; check its cable")}},
    "camera_skew": {"cameras": {"cam2": camera(skew_ms=-5.0)}},
    "frames_dropped": {"dropped_per_minute": 30.0},
    "disk_full": {"history_trouble": "no space left; free some"},
    "history_repaired": {"history_repair": "it was deleted; written again"},
    "users_unreadable": {"users_trouble": "file is not a database; restore it"},
    "recording_paused": {"recording_trouble": "no space left; free some"},
    "encoder_silent": {"encoder_silent_s": 9.0},
    "encoder_wrong": {"encoder_trouble": "runs backwards"},
    "no_measurement:load": {"area_mm2": NAN, "volume_flow_m3_h": NAN, "mass_flow_t_h": NAN},
    "no_measurement:speed": {"speed_mm_s": NAN},
    "no_measurement:lump": {"largest_lump_mm": NAN},
    "no_measurement:offset": {"belt_offset_mm": NAN},
    "certificate_expiring": {"certificate_days": 12.0},
}  # fmt: skip


class Plant:
    """A board, and the clocks that go with it."""

    def __init__(self, settings=SETTINGS):
        self.board = AlarmBoard(settings)
        self.second = 0

    def run(self, readings, seconds):
        """Update once a second; return every alarm that changed."""
        changed = []
        for _ in range(seconds):
            self.second += 1
            now = replace(readings, belt_mm=1500.0 * self.second)
            changed += self.board.update(now, 10**18 + self.second * SECOND, self.second * SECOND)
        return changed

    def states(self):
        return {alarm.name: alarm.state for alarm in self.board.alarms}


def test_every_rule_has_settings_a_text_and_a_case():
    kinds = {name.partition(":")[0] for name in BAD}
    assert set(RULES) == set(AlarmSettings.model_fields) - {"faults", "checks"} == set(TEXTS) == kinds


def test_all_alarms_are_clear_with_good_readings():
    plant = Plant()
    assert plant.run(GOOD, 300) == []
    assert set(plant.states().values()) == {"clear"}
    assert set(plant.states()) == set(BAD)


@pytest.mark.parametrize("name", BAD)
def test_every_alarm_is_raised_alone_and_clears(name):
    plant = Plant()
    plant.run(GOOD, 5)
    (raised,) = plant.run(replace(GOOD, **BAD[name]), 300)
    assert (raised.name, raised.state) == (name, "raised")
    assert raised.since_ns is not None
    assert raised.detail
    assert "{" not in raised.detail
    assert "\n" not in raised.detail
    over = plant.run(GOOD, 300)
    kind = name.partition(":")[0]
    latched = getattr(SETTINGS, kind).latched
    assert [alarm.state for alarm in over] == ["gone" if latched else "clear"]
    assert plant.board.acknowledge(name, "ada", 1) == latched
    assert set(plant.states().values()) == {"clear"}


@pytest.mark.parametrize("name", BAD)
def test_every_alarm_can_be_acknowledged_while_it_lasts(name):
    plant = Plant()
    plant.run(GOOD, 5)
    plant.run(replace(GOOD, **BAD[name]), 300)
    assert plant.board.acknowledge(name, "ada", 1)
    assert not plant.board.acknowledge(name, "bob", 1)
    assert plant.run(replace(GOOD, **BAD[name]), 100) == []
    (alarm,) = [one for one in plant.board.alarms if one.state != "clear"]
    assert (alarm.name, alarm.state, alarm.by) == (name, "acknowledged", "ada")
    (over,) = plant.run(GOOD, 300)
    assert (over.state, over.by, over.detail) == ("clear", "", "")


@pytest.mark.parametrize("name", [name for name in BAD if not name.startswith("no_measurement")])
def test_unknown_readings_neither_raise_nor_clear(name):
    kind = name.partition(":")[0]
    settings = AlarmSettings.model_validate({**SETTINGS.model_dump(), "no_measurement": {"enabled": False}})
    plant = Plant(settings)
    plant.run(Readings(), 300)
    assert set(plant.states().values()) == {"clear"}
    plant.run(replace(GOOD, **BAD[name]), 300)
    before = plant.states()
    assert before[name] == "raised"
    assert plant.run(Readings(), 300) == []
    assert plant.states() == before
    assert kind in RULES


def test_missing_load_is_raised_from_the_start_and_suppresses_the_rest():
    plant = Plant()
    assert plant.run(Readings(), 60) == []
    changed = plant.run(Readings(), 600)
    assert [alarm.name for alarm in changed] == ["no_measurement:load"]


def test_one_cause_raises_one_alarm():
    plant = Plant()
    plant.run(GOOD, 5)
    changed = plant.run(Readings(), 300)
    assert [alarm.name for alarm in changed] == ["no_measurement:load"]


def test_reversed_belt_is_not_stopped():
    assert Plant().run(replace(GOOD, speed_mm_s=-1500.0), 30) == []


def test_last_skew_of_a_lost_camera_raises_no_alarm():
    plant = Plant()
    lost = replace(GOOD, cameras={"cam1": camera("cam1"), "cam2": camera(state="lost", skew_ms=40.0)})
    assert [alarm.name for alarm in plant.run(lost, 30)] == ["camera_lost:cam2"]


def test_travel_counts_across_unknown_positions():
    board = AlarmBoard(AlarmSettings.model_validate({"overload": {"after_mm": 900}}))
    heavy = replace(GOOD, **BAD["overload"])
    for second, belt_mm in enumerate([0, 100, NAN, NAN, 950]):
        assert {a.name: a.state for a in board.alarms}.get("overload", "clear") == "clear"
        board.update(replace(heavy, belt_mm=belt_mm), 0, second * SECOND)
    assert {a.name: a.state for a in board.alarms}["overload"] == "raised"


def test_quantity_that_was_never_measured_raises_no_alarm():
    plant = Plant()
    blind = replace(GOOD, belt_offset_mm=NAN, speed_mm_s=NAN)
    assert plant.run(blind, 600) == []


@pytest.mark.parametrize(("field", "bad", "missed"), [
    ("largest_lump_mm", 230.0, "no_measurement:lump"), ("belt_offset_mm", 90.0, "no_measurement:offset"),
])  # fmt: skip
def test_periodic_quantity_is_raised_clears_and_is_missed(field, bad, missed):
    plant = Plant()

    def periodic(value, times):
        return [
            (alarm.name, alarm.state)
            for _ in range(times)
            for readings, seconds in (
                (replace(GOOD, **{field: value}), 1),
                (replace(GOOD, **{field: NAN}), 9),
            )
            for alarm in plant.run(readings, seconds)
        ]

    name = {"largest_lump_mm": "oversize_lump", "belt_offset_mm": "misaligned_belt"}[field]
    good = getattr(GOOD, field)
    assert periodic(good, 5) == []
    assert periodic(bad, 5) == [(name, "raised")]
    assert periodic(good, 5) == [(name, "gone")]
    assert periodic(NAN, 20) == [(missed, "raised")]
    assert periodic(good, 3) == [(missed, "gone")]


def test_camera_without_a_first_image_is_lost_after_waiting():
    plant = Plant()
    waiting = replace(GOOD, cameras={"cam2": camera(state="waiting")})
    assert plant.run(waiting, 29) == []
    (lost,) = plant.run(waiting, 2)
    assert lost.name == "camera_lost:cam2"
    assert lost.detail.startswith("cam2 gives no image")


def test_lost_camera_is_raised_at_once_with_its_own_message():
    plant = Plant()
    plant.run(GOOD, 1)
    (lost,) = plant.run(replace(GOOD, **BAD["camera_lost:cam2"]), 1)
    assert lost.detail == "silent for 1.0 s; check its cable"


def test_alarm_has_value_limit_and_unit():
    plant = Plant()
    (alarm,) = plant.run(replace(GOOD, **BAD["overload"]), 3)
    assert (alarm.value, alarm.limit, alarm.unit) == (120.0, 100.0, "%")
    assert alarm.detail == "120 %, limit 100 %: slow the feed"


def test_active_alarm_keeps_its_last_known_value():
    plant = Plant()
    plant.run(replace(GOOD, **BAD["oversize_lump"]), 1)
    plant.run(replace(GOOD, largest_lump_mm=NAN), 5)
    lump = {alarm.name: alarm for alarm in plant.board.alarms}["oversize_lump"]
    assert (lump.state, lump.value, lump.limit) == ("raised", 230, 200)


def test_misalignment_keeps_its_sign():
    plant = Plant()
    (alarm,) = plant.run(replace(GOOD, **BAD["misaligned_belt"]), 9)
    assert alarm.value == -70


def test_mass_flow_alone_raises_overload():
    plant = Plant(AlarmSettings.model_validate({"overload": {"fill": None, "mass_flow_t_h": 490}}))
    (alarm,) = plant.run(GOOD, 9)
    assert (alarm.name, alarm.unit) == ("overload", "t/h")


def test_load_on_a_stopped_belt_stays_an_overload():
    """Its delay runs in millimetres of belt."""
    board = AlarmBoard(AlarmSettings.model_validate({"overload": {"clear_after_mm": 500}}))
    heavy = replace(GOOD, **BAD["overload"])
    for second, (readings, belt_mm) in enumerate(
        [(heavy, 0), (heavy, 1500), (heavy, 3000), *[(GOOD, 3000)] * 50]
    ):
        board.update(replace(readings, belt_mm=belt_mm), 0, second * SECOND)
    assert {a.name: a.state for a in board.alarms}["overload"] == "raised"
    board.update(replace(GOOD, belt_mm=3600), 0, 60 * SECOND)
    assert {a.name: a.state for a in board.alarms}["overload"] == "gone"


def test_disabled_alarm_is_absent():
    settings = AlarmSettings.model_validate({name: {"enabled": False} for name in RULES})
    plant = Plant(settings)
    for wrong in BAD.values():
        assert plant.run(replace(GOOD, **wrong), 100) == []
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
    """What one alarm does, alone on the board or among all others, is the same."""
    every = Plant()
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


def test_camera_without_health_keeps_its_state():
    plant = Plant()
    plant.run(replace(GOOD, **BAD["camera_lost:cam2"]), 2)
    plant.run(replace(GOOD, cameras={}), 50)
    assert plant.states()["camera_lost:cam2"] == "raised"


def test_unknown_key_is_refused_with_the_nearest(tmp_path):
    from beltscape.core.errors import InputError

    with pytest.raises(InputError, match="did you mean speed_mm_s"):
        validate(tmp_path / "project.toml", AlarmSettings, {"belt_stopped": {"sped_mm_s": 3}})


def test_readings_are_unknown_by_default():
    for one in fields(Readings):
        value = getattr(Readings(), one.name)
        assert value is None or value in ({}, (), False) or np.isnan(value)


def make_finding(value: float, text: str = "", subject: str = "cam2") -> Finding:
    return Finding("camera_pose", value, 0.1, 1.0, "mm", subject, text)


def test_a_fault_is_an_alarm_with_the_name_of_its_check_and_camera():
    plant = Plant()
    plant.run(replace(GOOD, findings=[make_finding(0.2)]), 5)
    assert "camera_pose:cam2" not in plant.states()
    (raised,) = plant.run(replace(GOOD, findings=[make_finding(4.0, "cam2 moved by 4 mm")]), 5)
    assert (raised.name, raised.state, raised.detail) == ("camera_pose:cam2", "raised", "cam2 moved by 4 mm")
    assert (raised.value, raised.limit, raised.unit) == (4.0, 1.0, "mm")
    assert plant.run(replace(GOOD, findings=[make_finding(float("nan"))]), 300) == []  # not measured: unknown
    (over,) = plant.run(replace(GOOD, findings=[make_finding(0.2)]), 30)
    assert (over.name, over.state) == ("camera_pose:cam2", "gone")


def test_alarms_of_faults_can_be_switched_off():
    plant = Plant(AlarmSettings(faults=Fault(enabled=False)))
    assert plant.run(replace(GOOD, findings=[make_finding(4.0, "cam2 moved")]), 5) == []


def test_an_alarm_shows_the_worst_value_past_the_limit_not_the_present_one():
    plant = Plant()
    for size in (230.0, 260.0, 90.0, 215.0):
        plant.run(replace(GOOD, largest_lump_mm=size), 2)
    (lump,) = (alarm for alarm in plant.board.alarms if alarm.name == "oversize_lump")
    assert (lump.state, lump.value, lump.limit) == ("raised", 260.0, 200.0)
    assert "260 mm" in lump.detail
    plant.run(replace(GOOD, largest_lump_mm=90.0), 30)
    (lump,) = (alarm for alarm in plant.board.alarms if alarm.name == "oversize_lump")
    assert (lump.state, lump.value) == ("gone", 260.0)
    plant.run(replace(GOOD, largest_lump_mm=205.0), 2)  # another lump
    (lump,) = (alarm for alarm in plant.board.alarms if alarm.name == "oversize_lump")
    assert (lump.state, lump.value) == ("raised", 205.0)


def test_a_check_may_have_settings_of_its_own():
    settings = AlarmSettings(checks={"camera_pose": Fault(after_s=10, severity="info")})
    plant = Plant(settings)
    moved = make_finding(4.0, "cam2 moved by 4 mm")
    assert plant.run(replace(GOOD, findings=[moved]), 9) == []
    (raised,) = plant.run(replace(GOOD, findings=[moved]), 5)
    assert (raised.name, raised.severity) == ("camera_pose:cam2", "info")


def test_a_fault_that_stops_the_measurement_is_critical():
    text = Message("the projector is off", "projector_off", contrast=0, light=1)
    dark = Finding("projector", 0.0, 0.1, 1.0, "", text=text, effect="missing")
    (raised,) = Plant().run(replace(GOOD, findings=[dark]), 5)
    assert raised.severity == "critical"
    assert get_key(raised.detail) == "projector_off"


def test_alarms_of_measurement_are_held_during_maintenance():
    plant = Plant()
    plant.run(GOOD, 5)
    bad = Readings(
        cameras={"cam2": camera(state="lost")},
        coverage=0.1,
        history_trouble="no space left; free some",
        findings=[make_finding(4.0, "cam2 moved")],
    )
    assert [a.name for a in plant.run(replace(bad, is_maintained=True), 300)] == ["disk_full"]
    assert {a.name for a in plant.run(bad, 30)} >= {
        "camera_lost:cam2",
        "camera_pose:cam2",
        "no_measurement:load",
    }
    raised = plant.states()
    plant.run(replace(GOOD, is_maintained=True), 300)  # nor are they cleared
    held = {name for name, state in raised.items() if state == "raised" and name != "disk_full"}
    assert {name for name, state in plant.states().items() if state == "raised"} == held


def test_an_unknown_check_in_the_settings_is_refused():
    with pytest.raises(InputError, match=r"zero_shfit.*did you mean 'zero_shift'"):
        validate(Path("project.toml"), AlarmSettings, {"checks": {"zero_shfit": {"after_s": 3}}})
