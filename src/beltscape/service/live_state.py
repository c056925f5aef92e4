"""The live state of the running system: the engine updates it, pages and programs read it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from math import inf, isfinite, nan
from threading import Lock

from beltscape.core.alarms import Alarm
from beltscape.core.events import BeltStretch, CameraHealth, FrameEvent, Maintenance
from beltscape.core.findings import Finding
from beltscape.core.frames import Image
from beltscape.core.ledger import BeltRecord, Totals
from beltscape.pipeline.live.gauges import FramePace
from beltscape.service.belt_surface import BeltRows, SurfaceWindow
from beltscape.service.settings import WebSettings
from beltscape.service.view_models import (
    CheckState,
    CurrentFlow,
    DurationHistogram,
    FlowAverage,
    FlowPoint,
    FrameStatistics,
    Latency,
    LatencyMeter,
    Picture,
    Snapshot,
    encode_thumbnail,
)

_RECORDS, _POINTS, _NOTES, _CAMERAS, _CHECKS = 600, 3600, 50, 64, 1000
"""Records, points of curves (15 minutes), messages, cameras and checks that are kept for new pages."""
_POINT_S = 0.25
"""Period of the points of a curve: smooth for the eye."""
_MESSAGE_LENGTH = 500
"""Longer messages are cut, which bounds the memory; those of the program have up to 300 characters."""


@dataclass(slots=True)
class _CameraImage:
    """A camera's last image, and its encoded picture once one was requested."""

    frame: str
    wall_ns: int
    image: Image
    picture: Picture | None = None
    encoding: Lock = field(default_factory=Lock)


class LiveState:
    """An ``Observer`` that keeps the current state in bounded memory. Thread-safe."""

    def __init__(
        self,
        settings: WebSettings | None = None,
        *,
        monotonic_s: Callable[[], float] = time.monotonic,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.settings = settings or WebSettings()
        self._monotonic_s, self._wall_ns = monotonic_s, wall_ns
        self._lock = Lock()
        self._frames, self._totals = FrameStatistics(), Totals()
        self._cameras: dict[str, CameraHealth] = {}
        self._alarms: tuple[Alarm, ...] = ()
        self.alarm_followers: list[Callable[[Sequence[Alarm]], None]] = []
        """Called with all alarms after every update; each must return at once."""
        self._notes: deque[tuple[int, str]] = deque(maxlen=_NOTES)
        self._records: deque[BeltRecord] = deque(maxlen=_RECORDS)
        self._measured = 0
        """Number of the newest record in the flow."""
        self._points: deque[FlowPoint] = deque(maxlen=_POINTS)
        self._point_count, self._point_s = 0, -inf
        self._images: dict[str, _CameraImage] = {}
        self._frame_s = self._health_s = self._depth_s = -inf
        self._pace = FramePace()
        self._findings: dict[tuple[str, str], tuple[Finding, int, float]] = {}
        self._maintenance: Maintenance | None = None
        self._flow, self._belt = self._make_views(self.settings)
        self.durations = DurationHistogram()
        """Histogram of the processing times of frame sets."""
        self.latency = LatencyMeter()
        """From frame sets to their records."""

    def _make_views(self, settings: WebSettings) -> tuple[FlowAverage, SurfaceWindow]:
        flow = FlowAverage(settings.flow_window_s, monotonic_s=self._monotonic_s)
        return flow, SurfaceWindow(settings.belt_m, settings.belt_cell_mm)

    def set_settings(self, settings: WebSettings) -> None:
        """Show the state by other settings from now on; flow and belt begin anew where theirs have changed."""
        with self._lock:
            before, self.settings = self.settings, settings
            flow, belt = self._make_views(settings)
            if before.flow_window_s != settings.flow_window_s:
                flow.add(self._records)
                self._flow = flow
            if (before.belt_m, before.belt_cell_mm) != (settings.belt_m, settings.belt_cell_mm):
                self._belt = belt

    # events of the engine

    def on_frame(self, event: FrameEvent) -> None:
        """Update frame statistics, images and chart."""
        wall_ns, now_s = self._wall_ns(), self._monotonic_s()
        with self._lock:
            self._frame_s = now_s
            self._pace.add(now_s)
            if event.coverage > 0:
                self._depth_s = now_s
            self._frames = FrameStatistics(
                event.done,
                event.dropped,
                event.waiting,
                self._frames.seconds if event.is_repeat else event.seconds,
                event.coverage,
                event.speed_mm_s,
                event.largest_lump_mm,
                event.full_area_mm2,
                event.capacity,
                event.repeated,
            )
            if not event.is_repeat:
                self._add_latency(event, now_s)
            for name, image in islice(event.frames.images.items(), _CAMERAS):
                self._images[name] = _CameraImage(event.frames.frame, wall_ns, image)
            self._append_point(wall_ns, now_s)

    def _add_latency(self, event: FrameEvent, now_s: float) -> None:
        """Add how long a measured frame set took."""
        self.durations.add(event.seconds)
        position_mm = event.frames.position_mm
        self.latency.add_frame(
            event.frames.frame,
            event.seconds,
            now_s,
            nan if position_mm is None else position_mm,
            event.view_mm,
        )

    def restore_totals(self, totals: Totals) -> None:
        """Set the totals of the ledger at the program's start, unless records have arrived since."""
        with self._lock:
            if not self._records:
                self._totals = totals

    def on_measured(self, records: Sequence[BeltRecord]) -> None:
        """Update flow and chart, whether or not the disk takes the records."""
        with self._lock:
            self._add_to_flow(records)

    def on_records(self, records: Sequence[BeltRecord], totals: Totals) -> None:
        """Update records and totals; flow and chart by those records that they lack."""
        with self._lock:
            self._totals = totals
            now_s = self._monotonic_s()
            for record in records:
                if record.strip is not None:
                    self.latency.add_record(record.strip.frame, now_s)
            self._records.extend(records)
            self._add_to_flow(records)

    def _add_to_flow(self, records: Sequence[BeltRecord]) -> None:
        """Add the records that the flow lacks, each once."""
        self._flow.add([record for record in records if record.number > self._measured])
        self._measured = max(self._measured, *(record.number for record in records), 0)
        self._append_point(self._wall_ns(), self._monotonic_s())

    def summarise_latency(self) -> dict[str, Latency]:
        """Return how long records took to their publication, and frame sets to the end of their measurement.

        ``latency`` is that of records from their frame sets on, ``latency_after_view`` from the last frame set that
        saw their belt on, ``latency_of_frames`` that of frame sets.
        """
        with self._lock:
            return {
                "latency": self.latency.records.summarise(),
                "latency_after_view": self.latency.after_view.summarise(),
                "latency_of_frames": self.latency.frames.summarise(),
            }

    def on_surface(self, stretch: BeltStretch) -> None:
        """Add a finished piece of the belt's surface."""
        with self._lock:
            self._belt.add(stretch)

    def on_health(self, cameras: Mapping[str, CameraHealth]) -> None:
        """Update the health of the cameras."""
        with self._lock:
            self._health_s = self._monotonic_s()
            self._cameras = dict(islice(sorted(cameras.items()), _CAMERAS))

    def on_alarms(self, alarms: Sequence[Alarm]) -> None:
        """Update the alarms."""
        with self._lock:
            self._alarms = tuple(alarms)
        for follow in tuple(self.alarm_followers):
            follow(alarms)

    def on_findings(self, findings: Sequence[Finding]) -> None:
        """Update the checks; one that was not made this time keeps its newest finding."""
        with self._lock:
            now = self._wall_ns(), self._monotonic_s()
            for finding in findings:
                key = (finding.check, finding.subject)
                is_made = finding.is_fault or isfinite(finding.value)
                is_known = key in self._findings
                if (is_made or not is_known) and (is_known or len(self._findings) < _CHECKS):
                    self._findings[key] = finding, *now

    def on_maintenance(self, maintenance: Maintenance | None) -> None:
        """Begin or end maintenance: no flow is shown while it lasts."""
        with self._lock:
            self._maintenance = maintenance

    def on_message(self, message: str) -> None:
        """Append a message."""
        with self._lock:
            self._notes.append((self._wall_ns() // 1_000_000, message[:_MESSAGE_LENGTH]))

    def _append_point(self, wall_ns: int, now_s: float) -> None:
        """Append the flow to the chart, at most four times a second. A clock set back removes the points after it."""
        if now_s - self._point_s < _POINT_S:
            return
        self._point_s, wall_ms = now_s, wall_ns // 1_000_000
        while self._points and self._points[-1].wall_ms >= wall_ms:
            self._points.pop()
        self._points.append(FlowPoint(wall_ms, self._compute_flow()))
        self._point_count += 1

    def _compute_flow(self) -> CurrentFlow:
        if self._maintenance is not None:
            return CurrentFlow()
        depth_age_s = self._monotonic_s() - self._depth_s if isfinite(self._depth_s) else 0.0
        return self._flow.compute(self._frames.speed_mm_s, self._stale_s, depth_age_s)

    @property
    def _stale_s(self) -> float:
        return self._pace.stretch(self.settings.stale_s)

    # queries

    def take_snapshot(self) -> Snapshot:
        """Return the current state without pictures."""
        with self._lock:
            now_s = self._monotonic_s()
            return Snapshot(
                self._wall_ns(),
                self._frames,
                self._compute_flow(),
                self._totals,
                tuple(self._cameras.values()),
                self._alarms,
                tuple(self._notes),
                now_s - self._frame_s,
                now_s - self._health_s,
                self._records[-1].number if self._records else None,
                {name: last.frame for name, last in self._images.items()},
                self._maintenance,
                self._stale_s,
            )

    def list_checks(self) -> list[CheckState]:
        """Return the newest finding of every check, in the order of check and subject."""
        with self._lock:
            now_s = self._monotonic_s()
            return [
                CheckState(finding, wall_ns, now_s - made_s)
                for _, (finding, wall_ns, made_s) in sorted(self._findings.items())
            ]

    def list_points(self, after: int = 0) -> tuple[int, list[FlowPoint]]:
        """Return the number of points since the start, and those still kept after the first ``after``."""
        with self._lock:
            new = max(self._point_count - after, 0)
            first = max(len(self._points) - new, 0)
            return self._point_count, list(islice(self._points, first, None))

    def list_records(self, after: int = -1) -> list[BeltRecord]:
        """Return the kept records with a number greater than ``after``."""
        with self._lock:
            return [record for record in self._records if record.number > after]

    def get_belt(self, mark: tuple[int, int] | None = None) -> tuple[tuple[int, int], BeltRows | None]:
        """Return the current mark of the belt's surface, and its rows since ``mark``."""
        with self._lock:
            return self._belt.mark, self._belt.get_rows_after(mark)

    def get_picture(self, camera: str) -> Picture | None:
        """Return the camera's last image as a small picture, encoded once; None if it has sent none."""
        with self._lock:
            last = self._images.get(camera)
        if last is None:
            return None
        with last.encoding:
            if last.picture is None:
                data = encode_thumbnail(last.image, self.settings.picture_px)
                last.picture = Picture(last.frame, last.wall_ns, data)
            return last.picture
