"""The engine with its threads, a fake matcher and a real history loses no belt, whatever fails."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from beltscape.alarms.board import AlarmBoard
from beltscape.alarms.settings import AlarmSettings
from beltscape.core.belt.ledger_entries import BeltRecord, Totals
from beltscape.core.errors import OutputError
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.live import Alarm, BeltStretch, CameraHealth, FrameEvent, Maintenance
from beltscape.core.progress import Silent
from beltscape.health.belt.settings import BeltLimits
from beltscape.pipeline.live.engine import Engine, notify_records
from beltscape.pipeline.live.engine_components import EngineComponents
from beltscape.pipeline.live.frame_queue import FrameQueue
from beltscape.pipeline.live.gauges import Gauges
from beltscape.pipeline.live.inspector import PeriodicInspector
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementRun
from beltscape.pipeline.live.writer import Writer
from beltscape.pipeline.live.zero import FILE, ZeroControl
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.synthetic.belt_feed import CAMERA, CAMERAS, FakeMatcher, frames, make_context

STEP_MM = 60.0


class Feed:
    """A source of given frame sets with ``pause_s`` between them."""

    cameras = CAMERAS

    def __init__(self, sets: Sequence[FrameSet], pause_s: float = 0.0, fail_at: int | None = None) -> None:
        self.sets, self.pause_s, self.fail_at = list(sets), pause_s, fail_at
        self.closed = threading.Event()

    def __iter__(self) -> Iterator[FrameSet]:
        while self.sets and not self.closed.is_set():
            if self.fail_at == len(self.sets):
                self.fail_at = None
                raise RuntimeError("a driver fell over")
            yield self.sets.pop(0)
            self.closed.wait(self.pause_s)

    def health(self) -> Mapping[str, CameraHealth]:
        return {name: CameraHealth(name, "ok", 1, 0, 10.0, 0.0) for name in CAMERAS}

    def close(self) -> None:
        self.closed.set()


class Watcher:
    """An observer that keeps the events."""

    def __init__(self) -> None:
        self.frames: list[FrameEvent] = []
        self.records: list[BeltRecord] = []
        self.totals = Totals()
        self.alarms: dict[str, str] = {}
        self.stretches = 0
        self.findings: list[Finding] = []
        self.maintenance: list[Maintenance | None] = []

    def on_frame(self, event: FrameEvent) -> None:
        self.frames.append(event)

    def on_records(self, records: Sequence[BeltRecord], totals: Totals) -> None:
        self.records += records
        self.totals = totals

    def on_surface(self, stretch: BeltStretch) -> None:
        self.stretches += 1

    def on_health(self, cameras: Mapping[str, CameraHealth]) -> None:
        pass

    def on_alarms(self, alarms: Sequence[Alarm]) -> None:
        self.alarms.update({alarm.name: alarm.state for alarm in alarms})

    def on_findings(self, findings: Sequence[Finding]) -> None:
        self.findings += findings

    def on_maintenance(self, maintenance: Maintenance | None) -> None:
        self.maintenance.append(maintenance)

    def on_message(self, message: str) -> None:
        raise AssertionError(message)


def history(folder: Path) -> Historian:
    return Historian(folder, HistorySettings(reserve_mib=1))


def engine_of(
    folder: Path,
    feed: Feed,
    *,
    blocking: bool = True,
    matcher: FakeMatcher | None = None,
    sink: object = None,
) -> tuple[Engine, Watcher, Historian, EngineComponents]:
    historian, watcher, reporter = history(folder), Watcher(), Silent()
    resume = historian.ledger_end
    state = LedgerState(historian.begin_run(), resume.number + 1, resume.end_mm, resume.offset_mm)
    context = make_context()
    if matcher is not None:
        object.__setattr__(context, "matcher", matcher)
    writers = [Writer("historian", historian, notify_records(watcher, historian))]
    if sink is not None:
        writers.append(Writer("other", sink))  # type: ignore[arg-type]
    parts = EngineComponents(
        source=feed,
        encoder=None,
        queue=FrameQueue(2, blocking=blocking),
        measurement=MeasurementRun(context, state, CAMERAS, time.time_ns, reporter),
        historian=historian,
        writers=writers,
        recorder=None,
        board=AlarmBoard(AlarmSettings()),
        inspector=PeriodicInspector(context.empty_belt.belt, CAMERA, 0.0, 0.0),
        gauges=Gauges(1e5),
        zero=ZeroControl(context.empty_belt, BeltLimits(), folder / FILE, "learned", patience_s=20.0),
        observer=watcher,
        reporter=reporter,
        polls_encoder=False,
    )
    return Engine(parts), watcher, historian, parts


def track(start: float, stop: float) -> list[FrameSet]:
    return [frames(float(p), float(p)) for p in np.arange(start, stop, STEP_MM)]


def check(records: Sequence[BeltRecord]) -> None:
    for before, after in pairwise(records):
        assert after.number == before.number + 1
        assert after.belt_mm[0] == before.belt_mm[1]


def everything(historian: Historian) -> tuple[BeltRecord, ...]:
    return historian.records(0, time.time_ns() + 10**9, 10_000)


def test_records_reach_disk_and_observer_alike(tmp_path: Path) -> None:
    engine, watcher, historian, _ = engine_of(tmp_path, Feed(track(0, 1800)))
    engine.start()
    assert engine.wait(30)
    assert engine.stop() == 0
    kept = everything(historian)
    check(kept)
    assert len(kept) == 30
    assert [r.number for r in watcher.records] == [r.number for r in kept]
    assert watcher.totals == historian.totals
    assert historian.totals.volume_mm3 == pytest.approx(sum(r.volume_mm3 for r in kept), rel=1e-12)
    assert watcher.stretches > 3
    assert watcher.maintenance == []
    historian.close()


def test_slow_worker_drops_frames_and_keeps_the_ledger_complete(tmp_path: Path) -> None:
    class Slow(FakeMatcher):
        def reconstruct(self, frame_set, reporter, *, prior=None):
            time.sleep(0.06)
            return super().reconstruct(frame_set, reporter)

    engine, watcher, historian, parts = engine_of(
        tmp_path, Feed(track(0, 2400), pause_s=0.02), blocking=False, matcher=Slow()
    )
    engine.start()
    assert engine.wait(30)
    engine.stop()
    kept = everything(historian)
    check(kept)
    assert parts.queue.dropped > 5
    assert len(kept) + parts.queue.dropped == 40
    assert watcher.frames[-1].dropped == parts.queue.dropped
    assert kept[-1].belt_mm[1] - kept[0].belt_mm[0] == pytest.approx(2340 + kept[0].length_mm, abs=1.0)
    assert historian.totals.missing_mm == 0
    historian.close()


def test_a_deleted_history_is_written_again_and_reported(tmp_path: Path) -> None:
    engine, watcher, historian, parts = engine_of(tmp_path, Feed(track(0, 3000), pause_s=0.08))
    engine.start()
    time.sleep(1.5)
    for name in ("history.db", "history.db-wal", "history.db-shm"):
        (tmp_path / name).unlink()
    assert engine.wait(30)
    until = time.monotonic() + 5
    while watcher.alarms.get("history_repaired", "clear") == "clear" and time.monotonic() < until:
        time.sleep(0.05)
    engine.stop()
    assert watcher.alarms["history_repaired"] in ("raised", "gone")
    assert any("it was deleted while the program ran" in line for line in parts.reporter.warnings)  # type: ignore[attr-defined]
    names = {(event.kind, event.name) for event in historian.events(0, 1 << 62)}
    assert names >= {("note", "history"), ("alarm", "history_repaired")}
    check(everything(historian))
    assert len(everything(historian)) == 50
    historian.close()
    assert len(everything_of(tmp_path)) == 50


def everything_of(folder: Path) -> tuple[BeltRecord, ...]:
    historian = history(folder)
    kept = everything(historian)
    historian.close()
    return kept


def test_source_failure_is_reported_and_the_source_restarted(tmp_path: Path) -> None:
    feed = Feed(track(0, 900), fail_at=6)
    engine, _, historian, parts = engine_of(tmp_path, feed)
    engine.start()
    assert engine.wait(30)
    engine.stop()
    check(everything(historian))
    assert len(everything(historian)) == 15
    assert any("a driver fell over" in line for line in parts.reporter.warnings)  # type: ignore[attr-defined]
    historian.close()


def test_failed_frame_is_missing_and_measuring_restarts(tmp_path: Path) -> None:
    class Stumbling(FakeMatcher):
        def reconstruct(self, frame_set, reporter, *, prior=None):
            if frame_set.frame == "900.0":
                raise RuntimeError("a bug")
            return super().reconstruct(frame_set, reporter)

    engine, _, historian, parts = engine_of(tmp_path, Feed(track(0, 1800)), matcher=Stumbling())
    engine.start()
    assert engine.wait(30)
    engine.stop()
    kept = everything(historian)
    check(kept)
    assert [r.strip.frame for r in kept if r.strip is not None][-14:] == [
        f"{60.0 * k}" for k in range(16, 30)
    ]
    (gap,) = (r for r in kept if r.standing == "missing")
    assert 0 < gap.length_mm < 300 + STEP_MM
    assert kept[-1].belt_mm[1] - kept[0].belt_mm[0] == pytest.approx(1740 + kept[0].length_mm, abs=1.0)
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
    assert engine.wait(30)
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
        assert engine.wait(30)
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


def test_queue_keeps_the_newest_frames_in_order() -> None:
    queue = FrameQueue(2)
    for one in track(0, 300):
        queue.put(one)
    assert queue.dropped == 3
    taken = [queue.get(0), queue.get(0)]
    assert [one.frame for one in taken if one is not None] == ["180.0", "240.0"]
    assert queue.get(0.01) is None
    queue.close()
    assert queue.closed
