"""GenICam cameras as a live source of frame sets."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from beltscape.core.errors import InputError, SettingsError
from beltscape.core.events import CameraHealth
from beltscape.core.frames import FrameSet, Image
from beltscape.core.translatable_message import make_message
from beltscape.sources.genicam.camera import REOPEN_AFTER_S, CameraThreads, OpenCamera, TriggerPace
from beltscape.sources.genicam.device import RawImage
from beltscape.sources.genicam.health import CameraMonitor, assess_health, silence_limit_s
from beltscape.sources.genicam.matching import (
    BeltCounter,
    CameraImage,
    ExposureTimes,
    InstantMatcher,
    MatchedInstant,
    MatchingRules,
)
from beltscape.sources.genicam.pixels import decode_image
from beltscape.sources.genicam.settings import WINDOW_SHARE, CamerasSettings

READY = 16
"""Longest queue of frame sets; beyond it the oldest are dropped, so that the results stay current."""
START_S = 2.0
"""At the start the first camera waits this long for the others."""
CLOSE_S = 3.0
"""Closing waits this long for the cameras."""

Opener = Callable[[str], OpenCamera]


@dataclass(frozen=True, slots=True, eq=False)
class CountedImage:
    """An image with the encoder's count."""

    image: Image
    count: int | None
    exposure_us: float
    """NaN: not known."""


class GenicamSource:
    """Source of frame sets from cameras, which it opens, triggers, matches, monitors and reopens."""

    def __init__(
        self,
        settings: CamerasSettings,
        core: str,
        sizes_px: Mapping[str, tuple[int, int]] | None,
        opener: Opener,
    ) -> None:
        """Start the cameras; ``opener`` opens one by name or raises InputError."""
        self._settings = settings
        self._core = core
        self._sizes_px = sizes_px or {}
        self._lock = threading.Condition()
        self._matcher: InstantMatcher[CountedImage] = InstantMatcher(self.cameras, core, _rules(settings))
        self._counter = None if settings.encoder is None else BeltCounter(settings.encoder)
        self._ready: deque[FrameSet] = deque()
        self._exposures = _make_exposure_times(settings)
        start_s = time.monotonic()
        self._monitors = {name: CameraMonitor(start_s) for name in self.cameras}
        self._number = 0
        self._closed = self._is_fetched = False
        self.overrun = 0
        """Frame sets dropped since the start because the queue was full."""
        pace = (
            TriggerPace(time.monotonic(), 1 / settings.frames_per_s)
            if settings.trigger == "software"
            else None
        )
        self._threads = {
            name: CameraThreads(
                name,
                lambda n=name: opener(n),
                self._on_open,
                self._on_image,
                self._is_overdue,
                pace,
                self._on_exposure,
            )
            for name in self.cameras
        }

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras in the settings."""
        return tuple(self._settings.devices)

    def __iter__(self) -> Iterator[FrameSet]:
        """Yield frame sets until the source is closed; if they are not fetched in time, the oldest are dropped.

        It begins with the newest: those that came while the program was loading are not measured late.
        """
        with self._lock:
            while len(self._ready) > 1 and not self._is_fetched:
                self._ready.popleft()
            self._is_fetched = True
        while True:
            with self._lock:
                while not self._ready and not self._closed:
                    self._lock.wait(self._wait_s())
                    self._collect()
                if self._closed:
                    return
                one = self._ready.popleft()
            yield one

    def set_exposures(self, exposures_us: Mapping[str, float]) -> None:
        """Let cameras take new exposure times, µs, between two images; one that is lost does so on its return."""
        for name, exposure_us in exposures_us.items():
            self._threads[name].exposure_us = exposure_us

    def _on_exposure(self, name: str, exposure_us: float, at_ns: int) -> None:
        with self._lock:
            if self._exposures is not None:
                self._exposures.set_present(name, exposure_us, at_ns)

    def _wait_s(self) -> float | None:
        deadline_ns = self._matcher.deadline_ns()
        return None if deadline_ns is None else max(0.0, (deadline_ns - time.monotonic_ns()) * 1e-9)

    def _on_open(self, name: str) -> None:
        with self._lock:
            self._matcher.on_reopened(name)
            if name == self._core and self._counter is not None:
                self._counter.on_reopened()

    def _on_image(self, name: str, raw: RawImage) -> None:
        monitor, now_s = self._monitors[name], time.monotonic()
        try:
            image = self._image(name, raw)
        except InputError as error:
            with self._lock:
                monitor.add_image(now_s)
                monitor.image_fault = make_message("wrong_image", detail=str(error))
            return
        monitor.check_brightness(image, now_s)
        with self._lock:
            exposure_us = (
                float("nan") if self._exposures is None else self._exposures.find(name, raw.arrival_ns)
            )
            counted = CountedImage(image, raw.count, exposure_us)
            shot = CameraImage(name, raw.frame_id, raw.camera_ns, raw.arrival_ns, counted)
            monitor.add_image(now_s)
            monitor.image_fault = ""
            self._matcher.add(shot, time.monotonic_ns())
            self._collect()
            self._lock.notify_all()

    def _image(self, name: str, raw: RawImage) -> Image:
        wanted = self._sizes_px.get(name)
        if wanted is not None and raw.size_px != wanted:
            raise InputError(
                f"its images have {raw.size_px[0]}×{raw.size_px[1]} px, the rig's {wanted[0]}×{wanted[1]}: "
                "another camera, or its region or binning was changed"
            )
        return decode_image(raw.data, raw.code, raw.size_px)

    def _collect(self) -> None:
        for matched in self._matcher.pop_due(time.monotonic_ns()):
            self._ready.append(self._frame_set(matched))
            if len(self._ready) > READY:
                self._ready.popleft()
                self.overrun += 1

    def _frame_set(self, matched: MatchedInstant[CountedImage]) -> FrameSet:
        self._number += 1
        core = matched.shots.get(self._core)
        position_mm = None
        if self._counter is not None and core is not None and core.payload.count is not None:
            position_mm = self._counter.position_mm(core.payload.count)
        images = {name: matched.shots[name].payload.image for name in self.cameras if name in matched.shots}
        exposures_us = (
            {}
            if self._exposures is None
            else {name: matched.shots[name].payload.exposure_us for name in images}
        )
        return FrameSet(f"{self._number:08d}", images, matched.time_ns, position_mm, exposures_us)

    def _is_overdue(self, name: str, silence_s: float) -> bool:
        """Return whether a camera without an image for that time must be reopened."""
        if (
            self._settings.trigger == "line"
        ):  # the belt may stand: only other cameras show whether a pulse came
            with self._lock:
                statistics = self._matcher.statistics(name)
                return silence_s > REOPEN_AFTER_S and statistics.silent and statistics.has_clock
        return silence_s > max(REOPEN_AFTER_S, 2 * silence_limit_s(self._settings))

    def health(self) -> Mapping[str, CameraHealth]:
        """Return the state of every camera; from any thread, at any time."""
        now_s = time.monotonic()
        with self._lock:
            return {name: self._health(name, now_s) for name in self.cameras}

    def _health(self, name: str, now_s: float) -> CameraHealth:
        monitor, threads = self._monitors[name], self._threads[name]
        if threads.broken > monitor.broken:
            monitor.broken, monitor.broken_s = threads.broken, now_s
        statistics = self._matcher.statistics(name)
        return assess_health(
            name, self._settings, monitor, statistics, threads.trouble, threads.is_open, now_s
        )

    def close(self) -> None:
        """Stop the source; the iteration ends. A camera that does not answer is closed later by its own thread."""
        with self._lock:
            self._closed = True
            self._lock.notify_all()
        for threads in self._threads.values():
            threads.stop()
        until = time.monotonic() + CLOSE_S
        for threads in self._threads.values():
            threads.join(max(0.0, until - time.monotonic()))


def _make_exposure_times(settings: CamerasSettings) -> ExposureTimes | None:
    """Return the exposure times of all cameras; None if that of any is not known."""
    if not settings.exposures_us:
        return None
    period_ns = round(1e9 / settings.frames_per_s)
    return ExposureTimes(settings.exposures_us, period_ns, is_triggered=settings.trigger == "software")


def _rules(settings: CamerasSettings) -> MatchingRules:
    return MatchingRules(
        window_ns=round(WINDOW_SHARE * 1e9 / settings.frames_per_s),
        skew_ns=round(settings.allowed_skew_ms * 1e6),
        timeout_ns=round(settings.frame_timeout_ms * 1e6),
        clocks=settings.clocks,
        common_pulse=settings.trigger == "line",
        start_ns=round(START_S * 1e9),
    )


def open_cameras(
    settings: CamerasSettings, core: str, sizes_px: Mapping[str, tuple[int, int]] | None = None
) -> GenicamSource:
    """Start the cameras of ``settings``; absent ones are searched for as long as the source runs.

    ``core`` is the rig's core camera; ``sizes_px`` the (width, height) that each camera's images must have.
    SettingsError if Aravis is not installed or a camera of ``sizes_px`` has no device.
    """
    from beltscape.sources.genicam.aravis import load_aravis
    from beltscape.sources.genicam.device import Device

    load_aravis()
    for name in [core, *(sizes_px or {})]:
        if name not in settings.devices:
            raise SettingsError(
                f"cameras.devices: the rig's camera {name} has no device; there are {', '.join(settings.devices)}"
            )

    def opener(name: str) -> OpenCamera:
        return Device(name, settings, (sizes_px or {}).get(name), has_encoder=name == core)

    return GenicamSource(settings, core, sizes_px, opener)
