"""Frame sets on their way from the cameras: the queue before the worker, and adaptive exposure.

The bounded queue, when full, gives up the frame set without which the belt stays seen most evenly. The levels of the
frames and the belt's speed determine new exposure times.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import monotonic
from typing import Protocol

import numpy as np

from beltscape.core.events import FrameEvent, Maintenance
from beltscape.core.frames import FrameSet
from beltscape.core.interfaces import Observer
from beltscape.pipeline.live.frame_choice import find_least_needed
from beltscape.sources.genicam.adaptive_exposure import ExposureChange, ExposureController, measure_level
from beltscape.sources.genicam.settings import CamerasSettings


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A frame set with the time of its arrival."""

    frames: FrameSet
    at_s: float
    """Monotonic clock when it was put into the queue."""


class FrameQueue:
    """Holds a few frame sets; when it is full, a new one displaces one that waits, which is counted.

    It is the one whose neighbours lie closest together on the belt, the frame set taken last included: of a belt at
    rest or creeping those go first that show nothing new, and beyond what the computer can measure the views stay
    evenly spaced. The belt of a dropped frame is not lost to the ledger: the next frame's strip extends back over it.
    """

    def __init__(self, capacity: int, *, blocking: bool = False) -> None:
        """``blocking``: ``put`` waits for room instead of dropping, as a recording allows."""
        self.dropped = 0
        """Frame sets dropped so far."""
        self._capacity, self._blocking = capacity, blocking
        self._waiting: deque[Arrival] = deque()
        self._last: FrameSet | None = None
        self._changed = threading.Condition()
        self._closed = self._woken = False

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def closed(self) -> bool:
        """Return whether the queue is closed and empty."""
        return self._closed and not self._waiting

    def put(self, frames: FrameSet) -> None:
        """Append a frame set."""
        with self._changed:
            while self._blocking and len(self._waiting) >= self._capacity and not self._closed:
                self._changed.wait()
            if self._closed:
                return
            self._waiting.append(Arrival(frames, monotonic()))
            while len(self._waiting) > self._capacity:
                del self._waiting[find_least_needed(self._last, [each.frames for each in self._waiting])]
                self.dropped += 1
            self._changed.notify_all()

    def get(self, seconds: float) -> Arrival | None:
        """Remove and return the oldest; None if none arrives in time, or the queue is closed and empty."""
        with self._changed:
            if not self._waiting and not self._closed:
                self._changed.wait(seconds)
            if not self._waiting:
                return None
            oldest = self._waiting.popleft()
            self._last = oldest.frames
            self._changed.notify_all()
            return oldest

    def wait(self, seconds: float) -> bool:
        """Wait for a frame set or for `wake`; return whether either came in time."""
        with self._changed:
            if not self._waiting and not self._woken:
                self._changed.wait(seconds)
            woken, self._woken = self._woken, False
            return woken or bool(self._waiting)

    def wait_for_wake(self, seconds: float) -> None:
        """Wait for `wake`, at most for some time."""
        with self._changed:
            if not self._woken:
                self._changed.wait_for(lambda: self._woken, seconds)
            self._woken = False

    def wake(self) -> None:
        """Let the thread that waits, or waits next, go on; any thread may call it."""
        with self._changed:
            self._woken = True
            self._changed.notify_all()

    def set_capacity(self, capacity: int) -> None:
        """Hold at most that many frame sets from the next one on."""
        with self._changed:
            self._capacity = capacity
            self._changed.notify_all()

    def close(self) -> None:
        """Accept no further frame sets; those that wait can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


LogChange = Callable[[str, Mapping[str, object]], None]
"""Receives the text of a change and its parts."""


class AdjustableCameras(Protocol):
    """Cameras whose exposure times can be changed while they run."""

    def set_exposures(self, exposures_us: Mapping[str, float]) -> None:
        """Let cameras take new exposure times, µs."""
        ...


class ExposureControl(Observer):
    """Keeps the brightness of the pictures within the bounds of ``[cameras.adaptive_exposure]``.

    It observes the measured frames. During maintenance nothing is changed: people stand in the light.
    """

    def __init__(
        self,
        settings: CamerasSettings,
        cameras: AdjustableCameras,
        core: str,
        pixel_mm: float,
        log: LogChange,
    ) -> None:
        """``pixel_mm`` is the width of a pixel of the camera ``core`` on the belt."""
        assert settings.adaptive_exposure is not None
        self._settings, self._cameras, self._log = settings.adaptive_exposure, cameras, log
        self._core, self._pixel_mm = core, pixel_mm
        self._controller = ExposureController(self._settings, settings.exposures_us)
        self._speed_mm_s = float("nan")
        self._is_maintained = False

    @property
    def exposures_us(self) -> Mapping[str, float]:
        """Return the present exposure times by camera."""
        return self._controller.exposures_us

    def on_maintenance(self, maintenance: Maintenance | None) -> None:
        """Stop at the beginning of maintenance, go on at its end."""
        self._is_maintained = maintenance is not None

    def on_frame(self, event: FrameEvent) -> None:
        """Change the exposure times where the frame's level or the belt's speed demands it."""
        if np.isfinite(event.speed_mm_s):
            self._speed_mm_s = event.speed_mm_s
        if not self._is_maintained and self._is_present(event.frames):
            self._update(event.frames)

    def _is_present(self, frames: FrameSet) -> bool:
        """Return whether all images of a frame set have the exposure times that were set last."""
        present = self._controller.exposures_us
        return bool(frames.images) and all(
            frames.exposures_us.get(name) == present[name] for name in frames.images
        )

    def _update(self, frames: FrameSet) -> None:
        speed = abs(self._speed_mm_s)
        limit = 1e6 * self._settings.blur_px * self._pixel_mm / speed if speed > 0 else float("inf")
        seconds = (frames.time_ns or 0) * 1e-9
        change = self._controller.update(seconds, measure_level(frames.images), limit)
        if change is not None:
            self._cameras.set_exposures(change.exposures_us)
            self._log_change(change)

    def _log_change(self, change: ExposureChange) -> None:
        now = change.exposures_us[self._core]
        cause = (
            f"the belt moves at {abs(self._speed_mm_s):.0f} mm/s"
            if change.is_by_motion
            else f"level {change.level:.0f} of 255, wanted {self._settings.level:.0f}"
        )
        text = f"{now / change.factor:.0f} → {now:.0f} µs, all cameras × {change.factor:.2f}: {cause}"
        self._log(text, {"exposure_us": now, "factor": round(change.factor, 3), "level": round(change.level)})
