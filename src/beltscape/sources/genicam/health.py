"""Assessment of a camera's health from its images and statistics, with the fix of each fault."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from beltscape.core.events import CameraHealth, CameraState
from beltscape.core.frames import OVEREXPOSED_SHARE, Image, saturated_fraction
from beltscape.core.translatable_message import make_message
from beltscape.sources.genicam.matching import CameraStatistics
from beltscape.sources.genicam.settings import CamerasSettings

DARK = 0.03
"""A view whose brightest pixels stay below this share of the range is dark: 8 of 255 grey levels. Chosen."""
BRIGHTEST = 0.995
"""Quantile that counts as the brightest pixels: fewer are hot pixels and glints."""
RATE_WINDOW_S = 5.0
"""Interval over which the rate is counted: long enough for slow cameras, short enough to follow a change."""
BRIGHTNESS_INTERVAL_S = 1.0
"""Interval between checks of an image's brightness, which bounds their cost."""
SKEWED_FROM = 3
"""Number of consecutive images that must exceed the skew: a single one may by chance."""
RECENT_S = 10.0
"""Time for which a broken image is reported, so that a person sees it."""

START_GRACE_S = 15.0
"""Time after the start in which a camera is waited for: after a crash it refuses its next program until its heartbeat
expires (3 s in GenICam's default), and a busy host takes seconds for the first images."""
START_IMAGES = 30
"""Number of images after which a camera has started; its silence is a loss from then on."""
START_SILENCE_S = 5.0
"""Silence that is no loss within that time: the first frame sets occupy all processors."""


@dataclass(slots=True)
class CameraMonitor:
    """The observations of one camera."""

    start_s: float = float("-inf")
    """time.monotonic() at the start of the source."""
    last_s: float | None = None
    """time.monotonic() of its last image."""
    times_s: deque[float] = field(default_factory=lambda: deque(maxlen=8192))
    brightness_fault: str = ""
    """The fault of its brightness; empty without one."""
    image_fault: str = ""
    """Why its last image was unusable; empty if it was usable."""
    brightness_checked_s: float = float("-inf")
    broken: int = 0
    broken_s: float = float("-inf")
    """time.monotonic() at which a broken image was last counted."""

    def add_image(self, now_s: float) -> None:
        """Record the arrival of an image."""
        self.last_s = now_s
        self.times_s.append(now_s)

    def check_brightness(self, image: Image, now_s: float) -> None:
        """Check the brightness periodically."""
        if now_s - self.brightness_checked_s >= BRIGHTNESS_INTERVAL_S:
            self.brightness_checked_s = now_s
            self.brightness_fault = find_brightness_fault(image)

    def rate_hz(self, now_s: float) -> float:
        """Return the images per second of the last seconds."""
        while self.times_s and self.times_s[0] < now_s - RATE_WINDOW_S:
            self.times_s.popleft()
        count = len(self.times_s)
        return (count - 1) / (self.times_s[-1] - self.times_s[0]) if count > 1 else 0.0


def find_brightness_fault(image: Image) -> str:
    """Return the fault of an image's brightness; empty without one."""
    sample = image[::4, ::4]
    share = saturated_fraction(sample)
    if share > OVEREXPOSED_SHARE:
        return make_message("overexposed", share=round(100 * share))
    top = float(np.quantile(sample, BRIGHTEST)) / float(np.iinfo(image.dtype).max)
    if top < DARK:
        return make_message("dark", share=round(100 * top, 1))
    return ""


def assess_health(
    name: str,
    settings: CamerasSettings,
    monitor: CameraMonitor,
    statistics: CameraStatistics,
    trouble: str,
    is_open: bool,
    now_s: float,
) -> CameraHealth:
    """Return a camera's health at ``now_s`` (time.monotonic())."""
    state, message = _state(name, settings, monitor, statistics, trouble, is_open, now_s)
    return CameraHealth(
        name,
        state,
        statistics.taken,
        statistics.missed,
        0.0 if state == "lost" else monitor.rate_hz(now_s),
        float("nan") if statistics.skew_ns is None else statistics.skew_ns * 1e-6,
        message,
    )


def _state(
    name: str,
    settings: CamerasSettings,
    monitor: CameraMonitor,
    statistics: CameraStatistics,
    trouble: str,
    is_open: bool,
    now_s: float,
) -> tuple[CameraState, str]:
    is_starting = now_s - monitor.start_s < START_GRACE_S and statistics.taken < START_IMAGES
    if monitor.last_s is None:
        return _state_before_first_image(name, settings, trouble, is_open, is_starting)
    silence_s = now_s - monitor.last_s
    if (
        not is_open
        or statistics.silent
        or (settings.trigger != "line" and silence_s > silence_limit_s(settings))
    ):
        if is_starting and silence_s <= START_SILENCE_S:
            return _state_before_first_image(name, settings, "", is_open, is_starting)
        key = "silent_wire" if settings.trigger == "line" else "silent"
        return "lost", make_message(key, detail=trouble, seconds=round(silence_s))
    if monitor.image_fault:
        return "unusable", monitor.image_fault
    if statistics.unsynchronised:
        return "unusable", make_message("unsynchronised")
    if statistics.out_of_skew >= SKEWED_FROM:
        skew = "" if statistics.skew_ns is None else f"{statistics.skew_ns * 1e-6:+.2f} ms"
        return "unusable", make_message("skewed", detail=skew, limit=settings.allowed_skew_ms)
    if monitor.brightness_fault:
        return "unusable", monitor.brightness_fault
    if now_s - monitor.broken_s < RECENT_S:
        return "ok", make_message("packets", count=monitor.broken)
    return "ok", ""


def _state_before_first_image(
    name: str, settings: CamerasSettings, trouble: str, is_open: bool, is_starting: bool
) -> tuple[CameraState, str]:
    if trouble:
        return "waiting" if is_starting else "lost", make_message("unavailable", detail=trouble)
    if is_open and settings.trigger == "line":
        return "waiting", make_message("no_pulse", line=settings.trigger_line)
    device = settings.devices[name]
    return "waiting", make_message("starting" if is_open else "searching", device=device)


def silence_limit_s(settings: CamerasSettings) -> float:
    """Return the time without an image after which a camera that is free-running or software-triggered is lost."""
    return settings.frame_timeout_ms * 1e-3 + 2 / settings.frames_per_s
