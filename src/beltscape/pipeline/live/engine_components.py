"""The components of an engine: source, encoder, queue, measurement, sinks, alarms and observers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from beltscape.alarms.board import AlarmBoard
from beltscape.core.belt.ledger_entries import BeltRecord, RecordTag
from beltscape.core.geometry.rig import Rig
from beltscape.core.live.interfaces import LiveSource, Observer
from beltscape.core.progress import Reporter
from beltscape.pipeline.live.images.learned_images import LearnedImages
from beltscape.pipeline.live.intake.frame_queue import FrameQueue
from beltscape.pipeline.live.measurement.measurement_run import MeasurementContext, MeasurementRun
from beltscape.pipeline.live.monitoring.gauges import Gauges
from beltscape.pipeline.live.monitoring.inspector import PeriodicInspector
from beltscape.pipeline.live.operation.alarm_states import AlarmStateFile
from beltscape.pipeline.live.operation.hidden_alarms import HiddenAlarms
from beltscape.pipeline.live.operation.maintenance import MaintenanceMode
from beltscape.pipeline.live.operation.zero import ZeroControl
from beltscape.pipeline.live.reporting.event_log import EventLog
from beltscape.pipeline.live.reporting.finding_log import FindingLog
from beltscape.pipeline.live.writer import Writer
from beltscape.sinks.historian import Historian
from beltscape.sinks.recorder import Recorder
from beltscape.sources.encoder.protocol import Encoder


@dataclass(frozen=True, slots=True, eq=False)
class MeasuringParts:
    """The parts that belong to one rig and one empty belt; a running engine exchanges them between two records."""

    context: MeasurementContext
    rig: Rig
    """At the size of the cameras' images."""
    provenance: Mapping[str, str]
    """What is measured by: version, and the SHA-256 of rig, empty belt and settings."""
    inspector: PeriodicInspector
    zero: ZeroControl
    full_area_mm2: float
    """Cross-section of a full belt."""
    stale_s: float
    """Age from which a value is unknown to the alarms."""


@dataclass(frozen=True, slots=True, eq=False)
class EngineComponents:
    """The components of an engine."""

    source: LiveSource
    encoder: Encoder | None
    """The encoder; None where the frame sets contain the position, or the position is unknown."""
    queue: FrameQueue
    measurement: MeasurementRun
    historian: Historian
    events: EventLog
    writers: Sequence[Writer[BeltRecord]]
    recorder: Recorder | None
    board: AlarmBoard
    inspector: PeriodicInspector
    gauges: Gauges
    observer: Observer
    reporter: Reporter
    """Receives warnings."""
    polls_encoder: bool
    """Whether the encoder is read while no frame set arrives; False for a recording."""
    zero: ZeroControl
    certificate_days: Callable[[], float] = lambda: float("nan")
    users_trouble: Callable[[], str] = lambda: ""
    """Why nobody can sign in, in one line; empty without a fault."""
    reports_trouble: Callable[[], str] = lambda: ""
    """Why reports are not delivered, in one line; empty without a fault."""
    heartbeat: Callable[[], None] = lambda: None
    """Called periodically while the worker thread lives; it feeds a watchdog."""
    read_tag: Callable[[], RecordTag] = RecordTag
    """Returns what the next frame's record is counted for."""
    follow_timetable: Callable[[], None] = lambda: None
    """Called twice a second: changes the product by the timetable."""
    learned_images: LearnedImages = field(default_factory=LearnedImages)
    hidden_alarms: HiddenAlarms = field(default_factory=lambda: HiddenAlarms(None))
    alarm_states: AlarmStateFile = field(default_factory=lambda: AlarmStateFile(None))
    maintenance: MaintenanceMode = field(default_factory=lambda: MaintenanceMode(None))
    finding_log: FindingLog = field(default_factory=FindingLog)
