"""Maintenance: begun and ended by hand or by time, kept over a restart; its belt is missing."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.maintenance import MaintenanceMode, make_maintenance_finding, recover_maintenance
from beltscape.sinks.historian import Event
from tests.pipeline.live.feed import Feed, check, engine_of, everything, track
from tests.synthetic.belt_feed import frames, run


class Clock:
    def __init__(self) -> None:
        self.now_s, self.offset_s = 100.0, 1_800_000_000.0

    def monotonic_s(self) -> float:
        return self.now_s

    def wall_ns(self) -> int:
        return int((self.now_s + self.offset_s) * 1e9)


def open_mode(folder: Path | None, clock: Clock) -> MaintenanceMode:
    return MaintenanceMode(folder, clock.monotonic_s, clock.wall_ns)


def test_its_time_runs_by_the_monotonic_clock() -> None:
    clock = Clock()
    mode = open_mode(None, clock)
    assert mode.current is None and not mode.is_over
    mode.begin("cleaning", 10, "ana")
    clock.offset_s += 86_400  # the system clock jumps
    clock.now_s += 599
    assert mode.current is not None and not mode.is_over
    clock.now_s += 2
    assert mode.is_over
    ended = mode.end()
    assert ended is not None and ended.reason == "cleaning"
    assert mode.end() is None


def test_a_restart_continues_it_and_a_clock_set_back_does_not_lengthen_it(tmp_path: Path) -> None:
    clock = Clock()
    open_mode(tmp_path, clock).begin("cleaning", 10, "ana")
    clock.now_s += 60
    clock.offset_s -= 5_000
    again = open_mode(tmp_path, clock)
    assert again.current is not None and (again.current.reason, again.current.by) == ("cleaning", "ana")
    clock.now_s += 601
    assert again.is_over
    again.end()
    assert open_mode(tmp_path, clock).current is None


@pytest.mark.parametrize("text", ["", "[]", '{"reason": "x"}', "{" * 9, json.dumps({"until_ns": None})])
def test_a_damaged_file_is_no_maintenance(tmp_path: Path, text: str) -> None:
    (tmp_path / "maintenance.json").write_text(text)
    messages: list[str] = []
    assert MaintenanceMode(tmp_path, on_message=messages.append).current is None
    assert len(messages) == 1 and "maintenance.json" in messages[0] and "moved to" in messages[0]


def test_a_damaged_file_is_made_anew_from_the_history(tmp_path: Path) -> None:
    clock, folder = Clock(), tmp_path / "data"
    folder.mkdir()
    started = open_mode(folder, clock).begin("cleaning", 10, "ana")
    begin = {"action": "begin", "reason": "cleaning", "minutes": 10.0}
    events = [
        Event(3, started.since_ns, "alarm", "empty", "raised", ""),
        Event(2, started.since_ns, "maintenance", "begin", "x", "ana", json.dumps(begin)),
        Event(1, 5, "maintenance", "end", "x", "ana"),
    ]
    (folder / "maintenance.json").write_bytes(b"")
    clock.now_s += 60
    again = MaintenanceMode(
        folder, clock.monotonic_s, clock.wall_ns, print, lambda: recover_maintenance(events)
    )
    assert again.current == started
    assert open_mode(folder, clock).current == started  # it is on the disk again
    clock.now_s += 541
    assert again.is_over
    for ended in ([], events[2:], [Event(4, 9, "maintenance", "begin", "x", "", "{")]):
        assert recover_maintenance(ended) is None


def test_belt_that_passes_meanwhile_is_missing_and_has_no_volume() -> None:
    clock = Clock()
    mode = open_mode(None, clock)
    cleaning = mode.begin("cleaning", 10, "ana")
    measurement, entries = run(LedgerState(1, 0, None)), []
    for place in range(0, 3600, 60):
        present = cleaning if 1200 <= place < 2400 else None
        found = (make_maintenance_finding(present),)
        sets = frames(float(place), float(place), cameras=() if present else ("cam0", "cam1"))
        entries += measurement.push(sets, found).entries
    entries += measurement.finish().entries
    check(entries)
    missing = [entry for entry in entries if entry.standing == "missing"]
    assert missing and all(entry.volume_mm3 == 0 for entry in missing)
    assert any("(cleaning)" in entry.reason for entry in missing)
    # the belt in view at its begin was seen before
    assert 600 < sum(entry.length_mm for entry in missing) < 1300
    assert all("maintenance" not in entry.reason for entry in entries if entry.standing == "valid")


def test_the_engine_begins_and_ends_it_with_events(tmp_path: Path) -> None:
    engine, watcher, historian, _ = engine_of(tmp_path, Feed(track(0, 3600), pause_s=0.02))
    engine.start()
    assert engine.begin_maintenance("cleaning", 5, "ana")
    while len(watcher.frames) < 30:
        time.sleep(0.01)
    assert engine.end_maintenance("ben") and not engine.end_maintenance("ben")
    assert engine.wait(300)
    engine.stop()
    kept = everything(historian)
    check(kept)
    assert historian.totals.missing_mm > 600
    assert historian.totals.volume_mm3 == pytest.approx(
        sum(r.volume_mm3 for r in kept if r.standing != "missing")
    )
    events = {event.name: event for event in historian.events(0, time.time_ns() + 10**9)}
    assert (events["begin"].by, events["begin"].text) == ("ana", "cleaning, for at most 5 min")
    assert json.loads(events["end"].parameters) == {"action": "end", "reason": "cleaning"}
    assert [one and one.reason for one in watcher.maintenance] == ["cleaning", None]
    held = ("no_measurement", "camera_lost", "low_coverage", "belt_stopped", "maintenance")
    raised = [alarm for alarm, state in watcher.alarms.items() if state == "raised"]
    assert [alarm for alarm in raised if alarm.startswith(held)] == []
    series = historian.finding_series("maintenance", "", 0, time.time_ns() + 10**9, 1)
    assert series.faults[0] >= 1 and series.low[0] == 0.0
    historian.close()


def test_it_ends_after_its_time(tmp_path: Path) -> None:
    engine, watcher, historian, parts = engine_of(tmp_path, Feed(track(0, 3600), pause_s=0.05))
    parts.maintenance.begin("cleaning", 0.01, "ana")
    engine.start()
    deadline = time.monotonic() + 10
    while len(watcher.maintenance) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    engine.stop()
    assert [one and one.reason for one in watcher.maintenance] == ["cleaning", None]
    historian.close()
