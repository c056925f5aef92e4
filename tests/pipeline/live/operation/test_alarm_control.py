"""Alarms of a run: what people do to them is journalled, refused with one line, and kept over a restart."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from beltscape.alarms.board import AlarmBoard
from beltscape.alarms.settings import ShelvingSettings
from beltscape.core.errors import InputError
from beltscape.pipeline.live.alarm_control import AlarmControl, AlarmStateFile
from beltscape.pipeline.live.event_log import EventLog
from beltscape.pipeline.live.hidden_alarms import HiddenAlarms
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.alarms.plant import BAD, GOOD, SETTINGS
from tests.pipeline.live.feed import Watcher

LOST = replace(GOOD, **BAD["camera_lost:cam2"])
NAME = "camera_lost:cam2"


@dataclass
class Run:
    """A control with what it writes."""

    control: AlarmControl
    watcher: Watcher
    historian: Historian
    events: EventLog
    recordings: list[str]

    def close(self) -> None:
        """Store the waiting events and close the history."""
        assert self.events.close() == 0
        self.historian.close()

    def texts(self) -> list[str]:
        """Return name, text and user of the journal's entries, oldest first."""
        assert self.events.wait(20)
        events = self.historian.events(0, time.time_ns() + 10**9)
        return [f"{event.name} {event.text} {event.by}".strip() for event in reversed(events)]


def open_run(folder: Path, shelving: ShelvingSettings | None = None) -> Run:
    settings = SETTINGS.model_copy(update={"shelving": shelving or ShelvingSettings()})
    historian, watcher, kept = Historian(folder, HistorySettings(reserve_mib=1)), Watcher(), []
    events = EventLog(historian)
    control = AlarmControl(
        AlarmBoard(settings), HiddenAlarms(folder), events, watcher, kept.append,
        AlarmStateFile(folder), tuple(GOOD.cameras),
    )  # fmt: skip
    control.start()
    control.update(GOOD)
    return Run(control, watcher, historian, events, kept)


def test_a_shelved_alarm_is_journalled_hidden_and_shown_again(tmp_path: Path) -> None:
    run = open_run(tmp_path)
    run.control.update(LOST)
    run.control.shelve(NAME, "cable is coming", 30, "ada")
    assert run.watcher.alarms[NAME] == "clear"
    assert not run.control.acknowledge(NAME, "ada")
    run.control.update(LOST)
    run.control.return_to_service(NAME, "ben")
    assert run.watcher.alarms[NAME] == "raised"
    assert run.texts() == [
        "journal the program starts; present: none; hidden: none",
        f"{NAME} raised: silent for 1.0 s; check its cable",
        f"{NAME} shelved for 30 min: cable is coming ada",
        f"{NAME} shelving ended ben",
        f"{NAME} raised: silent for 1.0 s; check its cable",
    ]
    run.close()


def test_shelving_and_out_of_service_survive_a_restart(tmp_path: Path) -> None:
    run = open_run(tmp_path)
    run.control.shelve(NAME, "cable is coming", 30, "ada")
    run.control.take_out_of_service("overload", "no capacity known", "eve")
    run.close()
    again = open_run(tmp_path)
    again.control.update(replace(LOST, **BAD["overload"]))
    assert (again.watcher.alarms[NAME], again.watcher.alarms["overload"]) == ("clear", "clear")
    texts = again.texts()
    assert f"journal the program starts; present: none; hidden: {NAME}, overload" in texts
    assert f"{NAME} raised (shelved: cable is coming): silent for 1.0 s; check its cable" in texts
    again.close()


def test_shelving_ends_by_itself_with_an_entry(tmp_path: Path) -> None:
    run = open_run(tmp_path)
    run.control.update(LOST)
    run.control.shelve(NAME, "short", 0.001, "ada")
    time.sleep(0.1)
    run.control.update(LOST)
    assert run.watcher.alarms[NAME] == "raised"
    assert f"{NAME} shelving ends" in run.texts()
    run.close()


def test_what_must_not_be_is_refused_in_one_line(tmp_path: Path) -> None:
    run = open_run(tmp_path, ShelvingSettings(max_min=60, never=("overload",)))
    control = run.control
    for refused, match in [
        (lambda: control.shelve("overload", "x", 5, "ada"), "never"),
        (lambda: control.shelve(NAME, "x", 61, "ada"), "max_min = 60"),
        (lambda: control.shelve("camera_lost:cam9", "x", 5, "ada"), "no alarm of that name"),
        (lambda: control.take_out_of_service("nothing", "x", "ada"), "no alarm of that name"),
        (lambda: control.return_to_service(NAME, "ada"), "neither shelved"),
        (lambda: control.reset(NAME, "ada"), "not latched"),
    ]:
        with pytest.raises(InputError, match=match):
            refused()
    control.take_out_of_service(NAME, "repair", "eve")
    with pytest.raises(InputError, match="out of service"):
        control.shelve(NAME, "x", 5, "ada")
    run.close()


def test_a_critical_alarm_keeps_the_frames_unless_it_is_hidden(tmp_path: Path) -> None:
    run = open_run(tmp_path)
    run.control.update(replace(GOOD, history_trouble="no space left"))
    assert run.recordings == ["disk_full"]
    run.control.shelve("disk_full", "known", 5, "ada")
    run.control.update(GOOD)
    run.control.update(replace(GOOD, history_trouble="no space left"))
    assert run.recordings == ["disk_full"]
    run.close()


def test_an_acknowledgement_survives_a_restart_with_who_and_when(tmp_path: Path) -> None:
    run = open_run(tmp_path)
    run.control.update(replace(LOST, **BAD["disk_full"]))
    before_ns = time.time_ns()
    assert run.control.acknowledge(NAME, "ada")
    run.close()
    again = open_run(tmp_path)
    assert (again.watcher.alarms[NAME], again.watcher.alarms["disk_full"]) == ("acknowledged", "raised")
    assert f"journal the program starts; present: {NAME}, disk_full; hidden: none" in again.texts()
    again.control.update(replace(LOST, **BAD["disk_full"]))
    assert (again.watcher.alarms[NAME], again.watcher.alarms["disk_full"]) == ("acknowledged", "raised")
    (alarm,) = (alarm for alarm in AlarmStateFile(tmp_path).read().alarms if alarm.name == NAME)
    assert alarm.by == "ada" and before_ns <= (alarm.acknowledged_ns or 0) <= time.time_ns()
    again.close()
