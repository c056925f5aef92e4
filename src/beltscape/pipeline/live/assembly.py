"""Assembly of the live system: opens everything that a project.toml names and builds the engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from time import time_ns

from beltscape.alarms.board import AlarmBoard
from beltscape.core.errors import InputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.interfaces import LiveSource, Observer, Observers
from beltscape.core.progress import Reporter
from beltscape.files.atomic import ensure_output_folder
from beltscape.pipeline.live.alarm_control import AlarmStateFile
from beltscape.pipeline.live.engine import Engine
from beltscape.pipeline.live.engine_components import (
    EngineComponents,
    MeasuringParts,
    ReadCertificate,
    add_certificate,
)
from beltscape.pipeline.live.event_log import EventLog
from beltscape.pipeline.live.gauges import Gauges
from beltscape.pipeline.live.hidden_alarms import HiddenAlarms
from beltscape.pipeline.live.intake import ExposureControl, FrameQueue
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.maintenance import MaintenanceMode, recover_maintenance
from beltscape.pipeline.live.measurement_run import MeasurementContext, MeasurementRun
from beltscape.pipeline.live.measuring_parts import make_measuring_parts, read_run_rig
from beltscape.pipeline.live.production import ProductionControl
from beltscape.pipeline.live.project import Project, RunSettings, read_alarm_texts, require_cameras_of_banks
from beltscape.pipeline.live.reporting import DeduplicatingReporter
from beltscape.pipeline.live.writer import CsvTable, make_record_writer, notify_records
from beltscape.pipeline.measuring.instants import Instant, list_instants
from beltscape.pipeline.reconstructing.match_ahead import LiveWorkers, count_workers, open_live_workers
from beltscape.pipeline.reconstructing.reconstruction import open_capture
from beltscape.sinks.historian import Historian, LedgerEnd
from beltscape.sinks.recorder import Recorder
from beltscape.sources.encoder.opening import Encoder, open_encoder
from beltscape.sources.genicam.settings import CamerasSettings
from beltscape.sources.genicam.source import GenicamSource, open_cameras
from beltscape.sources.replay import FrameTime, ReplaySource

_END_OF_TIME_NS = 1 << 62
"""A time after every event."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """The options of a run that are not in its project.toml."""

    data: Path
    """Folder for history, recordings and tables."""
    paced: bool = True
    """True: replay a capture at its recorded pace; False: as fast as possible, without dropping a frame."""
    record: bool = True
    """Whether raw frame sets are recorded according to the settings."""
    learn_images: bool = False
    """Whether what sound images show is learned anew."""
    certificate_days: Callable[[], float] = field(default=lambda: float("nan"))
    read_certificate: ReadCertificate = field(default=lambda _: None)
    users_trouble: Callable[[], str] = field(default=lambda: "")
    reports_trouble: Callable[[], str] = field(default=lambda: "")
    heartbeat: Callable[[], None] = field(default=lambda: None)


@dataclass(frozen=True, slots=True, eq=False)
class AssembledRun:
    """An engine, its parts at the start, and the sinks that stay readable while it runs."""

    engine: Engine
    historian: Historian
    table: CsvTable
    components: EngineComponents
    parts: MeasuringParts
    production: ProductionControl
    """The present product and batch."""

    def close(self) -> None:
        """Close all sinks; call it after the engine has stopped and the last reader is done."""
        if self.components.workers is not None:
            self.components.workers.close()
        self.components.events.close()
        self.table.close()
        self.historian.close()


def assemble(project: Project[RunSettings], options: RunOptions, observer: Observer) -> AssembledRun:
    """Open everything that a run needs, without starting it; faults are found before anything is written.

    Raises
    ------
    InputError, SettingsError, MeasureError, OutputError
        With one line that names the fault and the fix.
    """
    reporter = DeduplicatingReporter(observer)
    rig = read_run_rig(project, reporter)
    with ExitStack() as opened:  # closed again where a later part fails
        # first: cameras take seconds to answer and workers a second to begin, in which the rest is loaded
        source = open_source(project, rig, reporter, paced=options.paced)
        opened.callback(source.close)
        workers = open_live_workers(project.settings.matching.workers)
        if workers is not None:
            opened.callback(workers.close)
        run = _assemble_around(source, workers, rig, project, options, observer, reporter)
        opened.pop_all()
        return run


def _assemble_around(
    source: LiveSource,
    workers: LiveWorkers | None,
    rig: Rig,
    project: Project[RunSettings],
    options: RunOptions,
    observer: Observer,
    reporter: Reporter,
) -> AssembledRun:
    """Open the other parts of a run; see ``assemble``."""
    settings = project.settings
    require_cameras_of_banks(project, rig.cameras)
    parts = make_measuring_parts(project, rig, reporter, options.data, workers)
    context = parts.context
    if options.learn_images:
        context.learned_images.learn_anew()
    check_encoder(project)
    historian = Historian(ensure_output_folder(options.data), settings.history)
    events = EventLog(historian)
    observer = _add_exposure_control(observer, settings.cameras, source, rig, context, events)
    encoder = _open_encoder(project, options, historian.ledger_end)
    state = _begin_run(historian, parts, options)
    writers = [make_record_writer("historian", historian, notify_records(observer, historian))]
    table = CsvTable(options.data / "csv", settings.csv, historian)
    writers.append(make_record_writer("csv", table))
    production = ProductionControl(settings.products, settings.production, historian.production, events)
    components = EngineComponents(
        source=source,
        encoder=encoder,
        queue=FrameQueue(settings.queue.frames, blocking=not options.paced),
        measurement=MeasurementRun(context, state, source.cameras, time_ns, reporter),
        historian=historian,
        events=events,
        writers=writers,
        recorder=Recorder(options.data / "recordings", settings.recording) if options.record else None,
        board=AlarmBoard(settings.alarms, read_alarm_texts(project)),
        hidden_alarms=HiddenAlarms(options.data, on_message=reporter.warn),
        alarm_states=AlarmStateFile(options.data, reporter.warn),
        inspector=parts.inspector,
        gauges=Gauges(parts.full_area_mm2, parts.stale_s),
        observer=observer,
        reporter=reporter,
        polls_encoder=settings.cameras is not None,
        zero=parts.zero,
        certificate_days=options.certificate_days,
        provenance=parts.provenance,
        read_certificate=options.read_certificate,
        users_trouble=options.users_trouble,
        reports_trouble=options.reports_trouble,
        heartbeat=options.heartbeat,
        maintenance=_open_maintenance(options.data, historian, reporter),
        workers=workers,
        learned_images=context.learned_images,
        drift=parts.drift,
        read_tag=lambda: production.tag,
        follow_timetable=production.follow_timetable,
    )
    _watch_workers(components)
    return AssembledRun(Engine(components), historian, table, components, parts, production)


def _watch_workers(components: EngineComponents) -> None:
    """Have the ends of matches and calls wake the queue, and deaths of workers noted."""
    if components.workers is None:
        return
    for pool in (components.workers.pool, components.workers.helpers):
        pool.on_end = components.queue.wake
        pool.on_death = lambda line: components.events.add("worker", "replaced", line, time_ns())


def _begin_run(historian: Historian, parts: MeasuringParts, options: RunOptions) -> LedgerState:
    """Begin a run with what it is measured by and the certificate in force; return the state of the ledger."""
    resume, certificate = historian.ledger_end, options.read_certificate(parts.provenance)
    run = historian.begin_run(add_certificate(parts.provenance, certificate))
    return LedgerState(run, resume.number + 1, resume.end_mm, resume.offset_mm)


def _add_exposure_control(
    observer: Observer,
    settings: CamerasSettings | None,
    source: LiveSource,
    rig: Rig,
    context: MeasurementContext,
    events: EventLog,
) -> Observer:
    """Return the observer with the control of the exposure times, where the settings of the cameras have bounds."""
    if settings is None or settings.adaptive_exposure is None or not isinstance(source, GenicamSource):
        return observer
    distance_mm = float(context.empty_belt.belt.belt_from_core.inverse().translation_mm[2])
    pixel_mm = distance_mm / float(rig.core_camera.focal_px.mean())

    def log(text: str, parts: Mapping[str, object]) -> None:
        events.add("exposure", "changed", text, time_ns(), parameters=parts)

    control = ExposureControl(settings, source, rig.core, pixel_mm, log)  # pyrefly: ignore[bad-instantiation]
    return Observers((observer, control))


def _open_maintenance(data: Path, historian: Historian, reporter: Reporter) -> MaintenanceMode:
    """Return the maintenance of an earlier run that has not ended, by the history where its file is damaged."""
    return MaintenanceMode(
        data,
        on_message=reporter.warn,
        recover=lambda: recover_maintenance(historian.events(0, _END_OF_TIME_NS)),
    )


def check_encoder(project: Project[RunSettings]) -> None:
    """Open the encoder and close it again; InputError if its file cannot be read or its port is in use."""
    capture = project.settings.capture
    folder = None if capture is None else project.resolve(capture.folder)
    settings = project.settings.encoder
    if settings.kind == "file" and project.resolve(Path(settings.path)).is_dir():
        raise InputError(f"{project.resolve(Path(settings.path))}: is a folder; give the CSV file that grows")
    opened = open_encoder(settings, project.path.parent, capture=folder)
    if opened is not None:
        opened.close()


def _open_encoder(project: Project[RunSettings], options: RunOptions, resume: LedgerEnd) -> Encoder | None:
    """Open the encoder, which continues where the ledger ended; None if the capture's frames contain its readings."""
    ended_mm = None if resume.end_mm is None else resume.end_mm - resume.offset_mm
    settings = project.settings
    if settings.encoder.kind == "capture" and settings.capture is not None and not settings.encoder.path:
        return None
    capture = None if settings.capture is None else project.resolve(settings.capture.folder)
    return open_encoder(
        settings.encoder, project.path.parent, capture=capture, data=options.data, resume_mm=ended_mm
    )


def open_source(project: Project[RunSettings], rig: Rig, reporter: Reporter, *, paced: bool) -> LiveSource:
    """Return the project's cameras or its recorded capture; ``paced``: replay the capture at its recorded pace."""
    settings = project.settings
    if settings.cameras is not None:
        return open_cameras(
            settings.cameras, rig.core, {name: camera.size_px for name, camera in rig.cameras.items()}
        )
    assert settings.capture is not None  # read_project saw to it
    folder = open_capture(project.resolve(settings.capture.folder), rig, reporter)
    table = folder.folder / "encoder.csv" if settings.encoder.kind == "capture" else None
    instants = list_instants(folder, table, settings.capture.frames_per_s, reporter)
    frame_times = [_frame_time(project, instant) for instant in instants]
    return ReplaySource(
        folder,
        frame_times,
        paced=paced,
        loop=settings.capture.loop,
        reads_ahead=count_workers(settings.matching.workers) > 0,
    )


def _frame_time(project: Project[RunSettings], instant: Instant) -> FrameTime:
    if instant.time_ns is None:
        raise InputError(
            f"{project.path}: [capture] has no encoder.csv with its times; give frames_per_s = …"
        )
    return FrameTime(instant.frame, instant.time_ns, instant.position_mm)
