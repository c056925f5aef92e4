"""Alarms by their quantities: what is raised by missing, periodic, signed and lasting readings."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from beltscape.alarms.board import AlarmBoard
from beltscape.alarms.readings import Readings
from beltscape.alarms.settings import AlarmSettings
from beltscape.core.events import NO_CAPACITY
from beltscape.health.camera_poses import count_unchecked, make_unchecked_finding
from tests.alarms.plant import BAD, GOOD, NAN, SECOND, Plant, camera


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
    missing: dict[str, Any] = {field: NAN}

    def periodic(value: Any, times):
        return [
            (alarm.name, alarm.state)
            for _ in range(times)
            for readings, seconds in (
                (replace(GOOD, **{field: value}), 1),
                (replace(GOOD, **missing), 9),
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


def test_camera_without_health_keeps_its_state():
    plant = Plant()
    plant.run(replace(GOOD, **BAD["camera_lost:cam2"]), 2)
    plant.run(replace(GOOD, cameras={}), 50)
    assert plant.states()["camera_lost:cam2"] == "raised"


def test_readings_are_unknown_by_default():
    for one in fields(Readings):
        value = getattr(Readings(), one.name)
        assert value in (None, NO_CAPACITY, {}, (), False) or np.isnan(value)


def test_an_alarm_shows_the_worst_value_past_the_limit_not_the_present_one():
    plant = Plant()
    for size in (230.0, 260.0, 90.0, 215.0):
        plant.run(replace(GOOD, largest_lump_mm=size), 2)
    (lump,) = (alarm for alarm in plant.board.alarms if alarm.name == "oversize_lump")
    assert (lump.state, lump.value, lump.limit) == ("raised", 260.0, 200.0)
    assert "260 mm" in lump.detail
    plant.run(replace(GOOD, largest_lump_mm=90.0), 30)
    (lump,) = (alarm for alarm in plant.board.alarms if alarm.name == "oversize_lump")
    assert (lump.state, lump.value) == ("gone", 90.0)
    assert lump.detail == "it is over; now 90.0 mm, limit 200 mm: acknowledge it"
    plant.run(replace(GOOD, largest_lump_mm=205.0), 2)  # another lump
    (lump,) = (alarm for alarm in plant.board.alarms if alarm.name == "oversize_lump")
    assert (lump.state, lump.value) == ("raised", 205.0)


def test_an_overload_gives_no_advice_while_the_flow_is_not_known():
    plant = Plant()
    plant.run(replace(GOOD, area_mm2=1.3e5), 5)
    unknown = replace(GOOD, area_mm2=NAN, volume_flow_m3_h=NAN, mass_flow_t_h=NAN)
    plant.run(unknown, 10)
    overload = plant.board.get("overload")
    assert overload is not None and overload.state == "raised" and not overload.is_known
    assert "feed" not in overload.detail and overload.detail.startswith("not known now")
    plant.run(replace(GOOD, area_mm2=1.3e5), 2)
    overload = plant.board.get("overload")
    assert overload is not None and overload.is_known and "slow the feed" in overload.detail


def test_cameras_that_could_not_be_checked_yet_are_not_moved():
    unchecked = make_unchecked_finding(10, 10)
    plant = Plant(AlarmSettings())
    assert plant.run(replace(GOOD, findings=[unchecked]), 25) == []
    (alarm,) = plant.run(replace(GOOD, findings=[unchecked]), 20)
    assert (alarm.name, alarm.severity, alarm.priority) == ("camera_pose_unchecked", "info", "low")
    plant.run(replace(GOOD, findings=[count_unchecked(0, 10)]), 15)
    assert plant.states()["camera_pose_unchecked"] == "clear"
