"""A feed of frame sets, a watcher and an engine for tests of the running system."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from beltscape.alarms.board import AlarmBoard
from beltscape.alarms.settings import AlarmSettings
from beltscape.core.alarms import Alarm
from beltscape.core.events import BeltStretch, CameraHealth, FrameEvent, Maintenance
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.ledger import BeltRecord, Totals
from beltscape.core.progress import Silent
from beltscape.health.settings import BeltLimits
from beltscape.pipeline.live.engine import Engine
from beltscape.pipeline.live.engine_components import EngineComponents, PeriodicInspector, ReadCertificate
from beltscape.pipeline.live.event_log import EventLog
from beltscape.pipeline.live.gauges import Gauges
from beltscape.pipeline.live.intake import FrameQueue
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementRun
from beltscape.pipeline.live.writer import make_record_writer, notify_records
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
        self.measured: list[BeltRecord] = []
        self.records: list[BeltRecord] = []
        self.totals = Totals()
        self.alarms: dict[str, str] = {}
        self.stretches = 0
        self.findings: list[Finding] = []
        self.maintenance: list[Maintenance | None] = []

    def on_frame(self, event: FrameEvent) -> None:
        self.frames.append(event)

    def on_measured(self, records: Sequence[BeltRecord]) -> None:
        self.measured += records

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
    read_certificate: ReadCertificate = lambda _: None,
) -> tuple[Engine, Watcher, Historian, EngineComponents]:
    historian, watcher, reporter = history(folder), Watcher(), Silent()
    resume = historian.ledger_end
    state = LedgerState(historian.begin_run(), resume.number + 1, resume.end_mm, resume.offset_mm)
    context = make_context()
    if matcher is not None:
        object.__setattr__(context, "matcher", matcher)
    writers = [make_record_writer("historian", historian, notify_records(watcher, historian))]
    if sink is not None:
        writers.append(make_record_writer("other", sink))  # type: ignore[arg-type]
    parts = EngineComponents(
        source=feed,
        encoder=None,
        queue=FrameQueue(2, blocking=blocking),
        measurement=MeasurementRun(context, state, CAMERAS, time.time_ns, reporter),
        historian=historian,
        events=EventLog(historian),
        writers=writers,
        recorder=None,
        board=AlarmBoard(AlarmSettings()),
        inspector=PeriodicInspector(context.empty_belt.belt, CAMERA, 0.0, 0.0),
        gauges=Gauges(1e5),
        zero=ZeroControl(context.empty_belt, BeltLimits(), folder / FILE, "learned", patience_s=20.0),
        observer=watcher,
        reporter=reporter,
        polls_encoder=False,
        provenance={"rig": "own"},
        read_certificate=read_certificate,
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


def everything_of(folder: Path) -> tuple[BeltRecord, ...]:
    historian = history(folder)
    kept = everything(historian)
    historian.close()
    return kept
