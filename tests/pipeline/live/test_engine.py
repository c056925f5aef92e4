"""The engine with its threads, a fake matcher and a real history loses no belt, whatever fails."""

from __future__ import annotations

import math
import sqlite3
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.errors import OutputError
from beltscape.core.ledger import BeltRecord
from beltscape.pipeline.live.engine import Engine
from beltscape.sinks.historian import database
from tests.pipeline.live.feed import (
    STEP_MM,
    Feed,
    check,
    engine_of,
    everything,
    everything_of,
    history,
    track,
)
from tests.protocols.broker import wait_until
from tests.synthetic.belt_feed import FakeMatcher


def test_records_reach_disk_and_observer_alike(tmp_path: Path) -> None:
    engine, watcher, historian, _ = engine_of(tmp_path, Feed(track(0, 1200)))
    engine.start()
    assert engine.wait(300)
    assert engine.stop() == 0
    kept = everything(historian)
    check(kept)
    assert len(kept) == 20
    assert [r.number for r in watcher.records] == [r.number for r in kept]
    assert watcher.totals == historian.totals
    assert historian.totals.volume_mm3 == pytest.approx(sum(r.volume_mm3 for r in kept), rel=1e-12)
    assert watcher.stretches > 3
    assert watcher.maintenance == []
    (measured,) = (event for event in historian.events(0, 1 << 62) if event.kind == "capacity")
    assert measured.text.startswith("this computer measures ")
    capacity = watcher.frames[-1].capacity
    view_mm = np.ptp(engine._components.measurement.context.empty_belt.window_mm)
    assert capacity.sets_per_s > 0.1
    assert capacity.speed_mm_s == pytest.approx(capacity.sets_per_s * view_mm / 2)
    assert all(math.isnan(one.capacity.sets_per_s) for one in watcher.frames[:4])
    historian.close()


def test_slow_worker_drops_frames_and_keeps_the_ledger_complete(tmp_path: Path) -> None:
    class Slow(FakeMatcher):
        def reconstruct(self, frame_set, reporter):
            time.sleep(0.06)
            return super().reconstruct(frame_set, reporter)

    engine, watcher, historian, parts = engine_of(
        tmp_path, Feed(track(0, 2400), pause_s=0.02), blocking=False, matcher=Slow()
    )
    engine.start()
    assert engine.wait(300)
    engine.stop()
    kept = everything(historian)
    check(kept)
    assert parts.queue.dropped > 5
    assert len(kept) + parts.queue.dropped == 40
    assert watcher.frames[-1].dropped == parts.queue.dropped
    # what waits in the queue grows older by the time of the set before it: 60 ms more than a set takes
    assert max(one.seconds for one in watcher.frames) > 2 * 0.06
    assert kept[-1].belt_mm[1] - kept[0].belt_mm[0] == pytest.approx(2340 + kept[0].length_mm, abs=1.0)
    assert historian.totals.missing_mm == 0
    historian.close()


def test_a_deleted_history_is_written_again_and_reported(tmp_path: Path) -> None:
    engine, watcher, historian, parts = engine_of(tmp_path, Feed(track(0, 2400), pause_s=0.08))
    engine.start()
    time.sleep(1.5)
    for name in ("history.db", "history.db-wal", "history.db-shm"):
        (tmp_path / name).unlink()
    assert engine.wait(300)
    until = time.monotonic() + 5
    while watcher.alarms.get("history_repaired", "clear") == "clear" and time.monotonic() < until:
        time.sleep(0.05)
    engine.stop()
    assert watcher.alarms["history_repaired"] in ("raised", "gone")
    assert any("it was deleted while the program ran" in line for line in parts.reporter.warnings)  # type: ignore[attr-defined]
    names = {(event.kind, event.name) for event in historian.events(0, 1 << 62)}
    assert names >= {("note", "history"), ("alarm", "history_repaired")}
    check(everything(historian))
    assert len(everything(historian)) == 40
    historian.close()
    assert len(everything_of(tmp_path)) == 40


def test_source_failure_is_reported_and_the_source_restarted(tmp_path: Path) -> None:
    feed = Feed(track(0, 900), fail_at=6)
    engine, _, historian, parts = engine_of(tmp_path, feed)
    engine.start()
    assert engine.wait(300)
    engine.stop()
    check(everything(historian))
    assert len(everything(historian)) == 15
    assert any("a driver fell over" in line for line in parts.reporter.warnings)  # type: ignore[attr-defined]
    historian.close()


def test_failed_frame_is_missing_and_measuring_restarts(tmp_path: Path) -> None:
    class Stumbling(FakeMatcher):
        def reconstruct(self, frame_set, reporter):
            if frame_set.frame == "900.0":
                raise RuntimeError("a bug")
            return super().reconstruct(frame_set, reporter)

    engine, _, historian, parts = engine_of(tmp_path, Feed(track(0, 1500)), matcher=Stumbling())
    engine.start()
    assert engine.wait(300)
    engine.stop()
    kept = everything(historian)
    check(kept)
    assert [r.strip.frame for r in kept if r.strip is not None][-9:] == [f"{60.0 * k}" for k in range(16, 25)]
    (gap,) = (r for r in kept if r.standing == "missing")
    assert 0 < gap.length_mm < 300 + STEP_MM
    assert kept[-1].belt_mm[1] - kept[0].belt_mm[0] == pytest.approx(1440 + kept[0].length_mm, abs=1.0)
    assert sum("a bug" in line for line in parts.reporter.warnings) == 1  # type: ignore[attr-defined]
    historian.close()


def test_refused_records_are_offered_again_without_delaying_frames(tmp_path: Path) -> None:
    class Moody:
        def __init__(self) -> None:
            self.refusals, self.kept = 2, list[BeltRecord]()

        def write(self, records: Sequence[BeltRecord]) -> None:
            if self.refusals:
                self.refusals -= 1
                raise OutputError("the share is not there; mount it")
            self.kept += records

        def close(self) -> None:
            pass

    moody = Moody()
    engine, _, historian, parts = engine_of(tmp_path, Feed(track(0, 900)), sink=moody)
    engine.start()
    assert engine.wait(300)
    deadline = time.monotonic() + 10
    while len(parts.writers[1]) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert engine.stop() == 0
    assert [r.number for r in moody.kept] == [r.number for r in everything(historian)]
    historian.close()


def test_runs_follow_one_another(tmp_path: Path) -> None:
    for start, stop in ((0, 900), (900, 1500), (2700, 3300)):
        engine, _, historian, _ = engine_of(tmp_path, Feed(track(start, stop)))
        engine.start()
        assert engine.wait(300)
        engine.stop()
        historian.close()
    again = history(tmp_path)
    kept = everything(again)
    check(kept)
    assert {r.run for r in kept} == {1, 2, 3}
    gaps = [r for r in kept if r.strip is None]
    assert len(gaps) == 1
    assert again.totals.missing_mm == pytest.approx(gaps[0].length_mm)
    assert again.totals.length_mm == pytest.approx(kept[-1].belt_mm[1] - kept[0].belt_mm[0])
    again.close()


@pytest.mark.thorough
def test_another_program_that_holds_the_history_delays_only_the_storing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database, "BUSY_S", 0.3)
    feed, beats = Feed(track(0, 60_000), pause_s=0.05), list[float]()
    _, watcher, historian, parts = engine_of(tmp_path, feed)
    engine = Engine(replace(parts, heartbeat=lambda: beats.append(time.monotonic())))
    holder = sqlite3.connect(tmp_path / "history.db", isolation_level=None)
    holder.execute("BEGIN IMMEDIATE")
    engine.start()
    wait_until(lambda: watcher.alarms.get("disk_full") == "raised" and len(watcher.measured) > 20, 120)
    assert watcher.records == []  # measured and shown, not stored
    for trouble in (parts.writers[0].trouble, parts.events.trouble):
        assert "another program holds history.db; close it there; what waits is stored then" in trouble
    count = len(beats)
    wait_until(lambda: len(beats) > count + 2, 120)  # the monitor and the watchdog wait for nobody
    engine.begin_maintenance("cleaning", 5, "ana")
    assert historian.events(0, 1 << 62) == ()
    holder.execute("ROLLBACK")
    wait_until(lambda: len(watcher.records) > 20 and parts.events.trouble == "", 120)
    assert engine.stop() == 0
    check(everything(historian))
    assert [one.number for one in watcher.measured] == [one.number for one in everything(historian)]
    stored = [(one.kind, one.name, one.text.partition(":")[0]) for one in historian.events(0, 1 << 62)][::-1]
    assert stored[0][:2] == ("alarm", "journal")
    assert ("alarm", "disk_full", "raised") in stored
    assert ("maintenance", "begin", "cleaning, for at most 5 min") in stored
    holder.close()
    historian.close()
