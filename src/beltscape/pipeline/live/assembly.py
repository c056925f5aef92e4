"""project.toml → an engine, ready to start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import time_ns

import numpy as np

from beltscape.alarms.board import AlarmBoard
from beltscape.core.errors import InputError
from beltscape.core.live import LiveSource, Observer, RecordSink
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.core.scaling import scale_rig
from beltscape.files.folders.atomic import output_folder
from beltscape.files.rig_json import read_rig
from beltscape.measure.volume.capacity import compute_capacity_mm2
from beltscape.pipeline.live.deduplicating_reporter import Noting
from beltscape.pipeline.live.engine import Engine, Parts, told
from beltscape.pipeline.live.frame_queue import FrameQueue
from beltscape.pipeline.live.gauges import Gauges
from beltscape.pipeline.live.inspector import Looker
from beltscape.pipeline.live.ledger import Books
from beltscape.pipeline.live.measuring import Bench, Measuring
from beltscape.pipeline.live.project import Project, RunSettings, density_of
from beltscape.pipeline.live.writer import Writer
from beltscape.pipeline.measuring.flow import Instant, fitted, instants_of
from beltscape.pipeline.measuring.flow_chain import depths_over, ground_under
from beltscape.pipeline.reconstructing.checked_matcher import sequence_matcher
from beltscape.pipeline.reconstructing.reconstruction import open_capture
from beltscape.sinks.csv_sink import CsvSink
from beltscape.sinks.historian import Historian
from beltscape.sinks.recorder import Recorder
from beltscape.sinks.settings import CsvSettings
from beltscape.sources.encoder.opening import open_encoder
from beltscape.sources.encoder.protocol import Encoder
from beltscape.sources.genicam.source import open_cameras
from beltscape.sources.replay import FrameTime, ReplaySource

_FOR_EVER_NS, _PAGE = 1 << 62, 5000


@dataclass(frozen=True, slots=True)
class Ways:
    """How a run is to go, beside its settings."""

    data: Path
    """Folder for history, recordings and tables."""
    paced: bool = True
    """A capture at the pace of its times; else as fast as it can be measured, without dropping a frame."""
    record: bool = True
    """Whether raw frame sets are recorded as the settings say."""
    certificate_days: Callable[[], float] = field(default=lambda: float("nan"))
    alive: Callable[[], None] = field(default=lambda: None)


@dataclass(frozen=True, slots=True, eq=False)
class Assembled:
    """An engine, and what others may look into while it runs."""

    engine: Engine
    historian: Historian
    tables: Sequence[RecordSink]
    """Sinks beside the historian."""

    def close(self) -> None:
        """Once the engine has stopped and nobody reads any more."""
        for sink in (*self.tables, self.historian):
            sink.close()


def assemble(project: Project[RunSettings], ways: Ways, observer: Observer) -> Assembled:
    """Open all that a run needs; nothing has begun yet. What does not fit is found before anything is written.

    Raises
    ------
    InputError, SettingsError, MeasureError, OutputError
        With one line that names what is wrong and the mend.
    """
    settings, reporter = project.settings, Noting(observer)
    rig = read_rig(project.place(settings.rig))
    if settings.capture is not None:
        rig = fitted(rig, project.place(settings.capture.folder), reporter)
    bench = bench_of(project, rig, reporter)
    source = open_source(project, rig, reporter, paced=ways.paced)
    check_encoder(project)
    historian = Historian(output_folder(ways.data), settings.history)
    resume = historian.resume
    ended = None if resume.end_mm is None else resume.end_mm - resume.offset_mm
    encoder = _encoder(project, ways, ended)
    books = Books(historian.begin_run(), resume.number + 1, resume.end_mm, resume.offset_mm)
    writers = [Writer("historian", historian, told(observer, historian))]
    if historian.mended:
        reporter.warn(historian.mended)
    tables = [_table(ways.data / "csv", settings.csv, historian)] if settings.csv.enabled else []
    writers += [Writer("csv", table) for table in tables]
    recording = ways.record and settings.recording.mode != "off"
    watch = settings.watch
    belt, camera = bench.ground.belt, bench.rig.core_camera
    parts = Parts(
        source=source,
        encoder=encoder,
        queue=FrameQueue(settings.queue.frames, patient=not ways.paced),
        measuring=Measuring(bench, books, source.cameras, time_ns, reporter),
        historian=historian,
        writers=writers,
        recorder=Recorder(ways.data / "recordings", settings.recording) if recording else None,
        board=AlarmBoard(settings.alarms),
        looker=Looker(belt, camera, watch.lumps_every_s, watch.edges_every_s),
        gauges=Gauges(compute_capacity_mm2(belt, float(np.deg2rad(watch.surcharge_deg)))),
        observer=observer,
        reporter=reporter,
        ticks=settings.cameras is not None,
        certificate_days=ways.certificate_days,
        alive=ways.alive,
    )
    return Assembled(Engine(parts), historian, tables)


def _table(folder: Path, settings: CsvSettings, historian: Historian) -> CsvSink:
    """The table, with what the history has and it has not: a power cut may have taken its last rows."""
    table = CsvSink(folder, settings)
    while missing := historian.records(0, _FOR_EVER_NS, limit=_PAGE, after=table.last):
        table.write(missing)
    return table


def bench_of(project: Project[RunSettings], rig: Rig, reporter: Reporter) -> Bench:
    """What is measured with; images are matched at the width that the settings ask for."""
    settings, matching = project.settings, project.settings.matching
    width = rig.core_camera.size_px[0]
    if matching.width_px is not None and matching.width_px < width:
        rig = scale_rig(rig, matching.width_px / width)
    ground = ground_under(project.place(settings.empty), rig, settings.flow.cell_mm, reporter)
    near_far = depths_over(ground, matching.load_mm)
    matcher = sequence_matcher(rig, tuple(rig.cameras), near_far, matching.multiview())
    return Bench(rig, ground, matcher, settings.flow, density_of(project))


def check_encoder(project: Project[RunSettings]) -> None:
    """Open the encoder and close it again: InputError where its file cannot be read or its port is taken."""
    capture = project.settings.capture
    folder = None if capture is None else project.place(capture.folder)
    settings = project.settings.encoder
    if settings.kind == "file" and project.place(Path(settings.path)).is_dir():
        raise InputError(f"{project.place(Path(settings.path))}: is a folder; give the CSV file that grows")
    opened = open_encoder(settings, project.path.parent, capture=folder)
    if opened is not None:
        opened.close()


def _encoder(project: Project[RunSettings], ways: Ways, ended_mm: float | None) -> Encoder | None:
    """It goes on from where the ledger ended, in its own count. A replay's own table comes with its frames."""
    settings = project.settings
    if settings.encoder.kind == "capture" and settings.capture is not None and not settings.encoder.path:
        return None
    capture = None if settings.capture is None else project.place(settings.capture.folder)
    return open_encoder(
        settings.encoder, project.path.parent, capture=capture, data=ways.data, resume_mm=ended_mm
    )


def open_source(project: Project[RunSettings], rig: Rig, reporter: Reporter, *, paced: bool) -> LiveSource:
    """Return the project's cameras, or its recorded capture in their place; ``paced``: at the pace of its times."""
    settings = project.settings
    if settings.cameras is not None:
        return open_cameras(
            settings.cameras, rig.core, {name: camera.size_px for name, camera in rig.cameras.items()}
        )
    assert settings.capture is not None  # read_project saw to it
    folder = open_capture(project.place(settings.capture.folder), rig, reporter)
    table = folder.folder / "encoder.csv" if settings.encoder.kind == "capture" else None
    instants = instants_of(folder, table, settings.capture.frames_per_s, reporter)
    frame_times = [_frame_time(project, instant) for instant in instants]
    return ReplaySource(folder, frame_times, paced=paced, loop=settings.capture.loop)


def _frame_time(project: Project[RunSettings], instant: Instant) -> FrameTime:
    if instant.time_ns is None:
        raise InputError(
            f"{project.path}: [capture] has no encoder.csv that tells its times; give frames_per_s = …"
        )
    return FrameTime(instant.frame, instant.time_ns, instant.position_mm)
