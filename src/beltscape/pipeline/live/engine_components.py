"""The components of an engine: source, encoder, queue, measurement, sinks, alarms and observers.

One of them inspects the measured surface periodically for large lumps and belt misalignment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic

from beltscape.alarms.board import AlarmBoard
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import MeasureError
from beltscape.core.events import CertificateReading
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.core.interfaces import LiveSource, Observer
from beltscape.core.ledger import BeltRecord, RecordTag
from beltscape.core.progress import Reporter
from beltscape.measure.flow.periodic_checks import measure_belt_offset, measure_largest_lump
from beltscape.measure.lumps.settings import LumpSettings
from beltscape.pipeline.live.alarm_control import AlarmStateFile
from beltscape.pipeline.live.drift import DriftMonitor
from beltscape.pipeline.live.event_log import EventLog, FindingLog
from beltscape.pipeline.live.gauges import Gauges
from beltscape.pipeline.live.hidden_alarms import HiddenAlarms
from beltscape.pipeline.live.intake import FrameQueue
from beltscape.pipeline.live.learned_images import LearnedImages
from beltscape.pipeline.live.maintenance import MaintenanceMode
from beltscape.pipeline.live.measurement_run import MeasurementContext, MeasurementRun
from beltscape.pipeline.live.writer import Writer
from beltscape.pipeline.live.zero import ZeroControl
from beltscape.pipeline.reconstructing.match_ahead import LiveWorkers
from beltscape.sinks.historian import Historian
from beltscape.sinks.recorder import Recorder
from beltscape.sources.encoder.opening import Encoder

_NAN = float("nan")
_LUMP_SETTINGS = LumpSettings(raster_pixels=100_000)
"""Coarser than `measure lumps`: sizes differ by a percent or two, at a third of the cost."""


class PeriodicInspector:
    """Inspects the newest depth map; each inspection has its own period."""

    def __init__(self, belt: Belt, camera: Camera, lumps_every_s: float, edges_every_s: float) -> None:
        """``camera`` is the core camera; a period of 0 s switches the inspection off."""
        self._belt, self._camera = belt, camera
        self._period_s = {"lumps": lumps_every_s, "edges": edges_every_s}
        self._last = dict.fromkeys(self._period_s, float("-inf"))

    def inspect(self, gauges: Gauges) -> None:
        """Make the inspections that are due, if there is a new depth map."""
        now = monotonic()
        due = [name for name, period in self._period_s.items() if period and now - self._last[name] >= period]
        depth = gauges.depth
        if not due or depth is None:
            return
        gauges.depth = None
        for name in due:
            self._last[name] = monotonic()
            try:
                if name == "lumps":
                    value = measure_largest_lump(depth, self._camera, self._belt, _LUMP_SETTINGS)
                else:
                    value = measure_belt_offset(depth, self._camera, self._belt)
            except MeasureError:
                value = (_NAN, _NAN)
            with gauges.lock:
                if name == "lumps":
                    gauges.lump_mm, gauges.last_lump_mm = value, value[0]
                else:
                    gauges.offset_mm = value


ReadCertificate = Callable[[Mapping[str, str]], CertificateReading | None]


def add_certificate(provenance: Mapping[str, str], reading: CertificateReading | None) -> dict[str, str]:
    """Return the provenance of a run with the number of the certificate in force; empty where none is any more."""
    return dict(provenance) if reading is None else {**provenance, "certificate": reading.in_force}


class RunRegister:
    """Begins the runs of the history, each with what it is measured by and the certificate in force."""

    def __init__(self, historian: Historian, read: ReadCertificate, provenance: Mapping[str, str]) -> None:
        """``provenance`` is that of the present run, which is begun already."""
        self._historian, self._read, self._provenance = historian, read, provenance
        reading = read(provenance)
        self.certificate = "" if reading is None else reading.in_force
        """Number of the certificate that the present run's provenance has; empty: none."""

    def read_certificate(self) -> CertificateReading | None:
        """Return the newest certificate, against what is measured by now; None without one."""
        return self._read(self._provenance)

    def begin(self, provenance: Mapping[str, str]) -> int:
        """Begin a run that is measured by ``provenance``; return its number."""
        self._provenance = provenance
        described = add_certificate(provenance, self._read(provenance))
        self.certificate = described.get("certificate", "")
        return self._historian.begin_run(described)

    def follow(self) -> int | None:
        """Begin a run where another certificate is in force than the present run's; return its number, else None."""
        reading = self.read_certificate()
        number = "" if reading is None else reading.in_force
        return None if number == self.certificate else self.begin(self._provenance)


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
    drift: DriftMonitor | None = None
    """Follows the drift of the rig."""


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
    provenance: Mapping[str, str] = field(default_factory=dict[str, str])
    """What is measured by now, as `MeasuringParts.provenance`."""
    read_certificate: ReadCertificate = lambda _: None
    """Returns the newest certificate of the material test, against a provenance; None without one."""
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
    workers: LiveWorkers | None = None
    """Processes that match frame sets; None: the worker thread matches them."""
    learned_images: LearnedImages = field(default_factory=LearnedImages)
    hidden_alarms: HiddenAlarms = field(default_factory=lambda: HiddenAlarms(None))
    alarm_states: AlarmStateFile = field(default_factory=lambda: AlarmStateFile(None))
    maintenance: MaintenanceMode = field(default_factory=lambda: MaintenanceMode(None))
    finding_log: FindingLog = field(default_factory=FindingLog)
    drift: DriftMonitor | None = None
