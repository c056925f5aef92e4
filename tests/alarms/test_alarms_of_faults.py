"""Alarms of the checks' findings, and during maintenance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from beltscape.alarms.readings import Readings
from beltscape.alarms.settings import AlarmSettings, FaultAlarm
from beltscape.core.errors import InputError
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import Message, get_key
from beltscape.files.toml_text import validate
from tests.alarms.plant import GOOD, Plant, camera


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
    plant = Plant(AlarmSettings(faults=FaultAlarm(enabled=False)))
    assert plant.run(replace(GOOD, findings=[make_finding(4.0, "cam2 moved")]), 5) == []


def test_a_check_may_have_settings_of_its_own():
    settings = AlarmSettings(checks={"camera_pose": FaultAlarm(after_s=10, severity="info")})
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
    hidden = {a.name: a for a in plant.board.alarms if a.hidden_state == "raised"}
    assert {"camera_lost:cam2", "camera_pose:cam2", "no_measurement:load", "low_coverage"} <= set(hidden)
    assert {a.isa_state for a in hidden.values()} == {"suppressed_by_design"}
    assert {a.name for a in plant.run(bad, 30)} >= {
        "camera_lost:cam2",
        "camera_pose:cam2",
        "no_measurement:load",
    }
    raised = plant.states()
    held = {name for name, state in raised.items() if state == "raised" and name != "disk_full"}
    plant.run(replace(GOOD, is_maintained=True), 300)
    assert {name for name, state in plant.states().items() if state != "clear"} == {"disk_full"}
    held -= {"camera_pose:cam2"}  # of which nothing is known now
    plant.run(GOOD, 1)  # they came before maintenance, ended in it, and wait to be acknowledged
    assert {name for name, state in plant.states().items() if state == "gone"} == held | {"disk_full"}
    assert plant.states()["camera_pose:cam2"] == "raised"


def test_an_unknown_check_in_the_settings_is_refused():
    with pytest.raises(InputError, match=r"zero_shfit.*did you mean zero_shift"):
        validate(Path("project.toml"), AlarmSettings, {"checks": {"zero_shfit": {"after_s": 3}}})
