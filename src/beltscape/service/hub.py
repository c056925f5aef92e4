"""What is known at this moment, for everybody who looks: the engine tells it, pages and programs ask it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from math import inf, nan
from threading import Lock

from beltscape.core.belt_record import BeltRecord, Totals
from beltscape.core.frames import Image
from beltscape.core.live import Alarm, BeltStretch, CameraHealth, FrameEvent
from beltscape.service.settings import WebSettings
from beltscape.service.shown.belt import BeltRows, BeltWindow
from beltscape.service.shown.durations import DurationHistogram
from beltscape.service.shown.flow import CurrentFlow, FlowAverage
from beltscape.service.shown.picture import Picture, encode_thumbnail

_RECORDS, _POINTS, _NOTES, _CAMERAS = 600, 3600, 50, 64
_POINT_S = 0.25


@dataclass(frozen=True, slots=True)
class FlowPoint:
    """The flow at one instant, for the chart."""

    wall_ms: int
    """System clock, ms since 1970."""
    flow: CurrentFlow
    """As it was."""


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """How frame sets go through."""

    done: int = 0
    """Measured since the start."""
    dropped: int = 0
    """Left out since the start."""
    waiting: int = 0
    """In the queue."""
    seconds: float = nan
    """How long the last one took."""
    coverage: float = nan
    """Share of the last one that was measured."""
    speed_mm_s: float = nan
    """Of the belt at the last one; NaN: not known."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything but pictures, at one instant."""

    wall_ns: int
    """System clock."""
    frames: FrameStatistics
    """How frame sets go through."""
    flow: CurrentFlow
    """Volume and mass flow."""
    totals: Totals
    """The ledger's sums."""
    cameras: tuple[CameraHealth, ...]
    """In the order of their names."""
    alarms: tuple[Alarm, ...]
    """All, as they stand."""
    notes: tuple[tuple[int, str], ...]
    """The last remarks: system clock in ms, text."""
    frame_age_s: float
    """Seconds since the last frame set went through; inf: none yet."""
    health_age_s: float
    """Seconds since the cameras' health was told; inf: never."""
    record: int | None
    """Number of the newest record; None while there is none."""
    picture_frames: Mapping[str, str]
    """Name of the newest picture of every camera that ever gave one."""


@dataclass(slots=True)
class _CameraImage:
    """A camera's last image."""

    frame: str
    wall_ns: int
    image: Image
    picture: Picture | None = None
    making: Lock = field(default_factory=Lock)


class LiveState:
    """Implements core.live.Observer. Bounded memory; every method may be called from any thread."""

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
        self._notes: deque[tuple[int, str]] = deque(maxlen=_NOTES)
        self._records: deque[BeltRecord] = deque(maxlen=_RECORDS)
        self._points: deque[FlowPoint] = deque(maxlen=_POINTS)
        self._point_count, self._pointed_s = 0, -inf
        self._seen: dict[str, _CameraImage] = {}
        self._saw_s = self._health_s = -inf
        self._flow = FlowAverage(self.settings.flow_window_s)
        self._belt = BeltWindow(self.settings.belt_m, self.settings.belt_cell_mm)
        self.durations = DurationHistogram()
        """How long frame sets took."""

    # what the engine tells

    def on_frame(self, event: FrameEvent) -> None:
        """A frame set went through."""
        wall_ns, now_s = self._wall_ns(), self._monotonic_s()
        with self._lock:
            self._saw_s = now_s
            self._frames = FrameStatistics(
                event.done, event.dropped, event.waiting, event.seconds, event.coverage, event.speed_mm_s
            )
            self.durations.add(event.seconds)
            for name, image in islice(event.frames.images.items(), _CAMERAS):
                self._seen[name] = _CameraImage(event.frames.frame, wall_ns, image)
            self._point(wall_ns, now_s)

    def resumed(self, totals: Totals) -> None:
        """What the ledger added up to when the program was started."""
        with self._lock:
            if not self._records:
                self._totals = totals

    def on_records(self, records: Sequence[BeltRecord], totals: Totals) -> None:
        """Records were acknowledged; the totals with them."""
        with self._lock:
            self._totals = totals
            self._records.extend(records)
            self._flow.add(records)
            self._point(self._wall_ns(), self._monotonic_s())

    def on_surface(self, stretch: BeltStretch) -> None:
        """A further piece of the belt is finished."""
        with self._lock:
            self._belt.add(stretch)

    def on_health(self, cameras: Mapping[str, CameraHealth]) -> None:
        """How the cameras do."""
        with self._lock:
            self._health_s = self._monotonic_s()
            self._cameras = dict(islice(sorted(cameras.items()), _CAMERAS))

    def on_alarms(self, alarms: Sequence[Alarm]) -> None:
        """All alarms as they stand."""
        with self._lock:
            self._alarms = tuple(alarms)

    def on_message(self, message: str) -> None:
        """Something worth knowing, in one line."""
        with self._lock:
            self._notes.append((self._wall_ns() // 1_000_000, message[:500]))

    def _point(self, wall_ns: int, now_s: float) -> None:
        """Remember the flow for the chart, a few times a second; a clock set back forgets what lies after it."""
        if now_s - self._pointed_s < _POINT_S:
            return
        self._pointed_s, wall_ms = now_s, wall_ns // 1_000_000
        while self._points and self._points[-1].wall_ms >= wall_ms:
            self._points.pop()
        self._points.append(FlowPoint(wall_ms, self._flow.compute(self._frames.speed_mm_s)))
        self._point_count += 1

    # what others ask

    def now(self) -> Snapshot:
        """Everything but pictures."""
        with self._lock:
            now_s = self._monotonic_s()
            return Snapshot(
                self._wall_ns(),
                self._frames,
                self._flow.compute(self._frames.speed_mm_s),
                self._totals,
                tuple(self._cameras.values()),
                self._alarms,
                tuple(self._notes),
                now_s - self._saw_s,
                now_s - self._health_s,
                self._records[-1].number if self._records else None,
                {name: seen.frame for name, seen in self._seen.items()},
            )

    def points(self, after: int = 0) -> tuple[int, list[FlowPoint]]:
        """How many points there were since the start, and the kept ones after the first ``after``."""
        with self._lock:
            new = max(self._point_count - after, 0)
            first = max(len(self._points) - new, 0)
            return self._point_count, list(islice(self._points, first, None))

    def records(self, after: int = -1) -> list[BeltRecord]:
        """The last records, those with a greater number than that."""
        with self._lock:
            return [record for record in self._records if record.number > after]

    def belt(self, mark: tuple[int, int] | None = None) -> tuple[tuple[int, int], BeltRows | None]:
        """Where the belt's surface stands now, and its rows since that mark."""
        with self._lock:
            return self._belt.mark, self._belt.after(mark)

    def picture(self, camera: str) -> Picture | None:
        """The camera's last image, small; made once however many ask; None where it never gave one."""
        with self._lock:
            seen = self._seen.get(camera)
        if seen is None:
            return None
        with seen.making:
            if seen.picture is None:
                data = encode_thumbnail(seen.image, self.settings.picture_px)
                seen.picture = Picture(seen.frame, seen.wall_ns, data)
            return seen.picture
