"""The threads of one camera: they open it, receive its images, trigger it, and reopen it after a loss."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from beltscape.core.supervision import make_supervised_thread
from beltscape.sources.genicam.device import RawImage

REOPEN_AFTER_S = 1.5
"""A camera without an image for this time, when one was due, is reopened; chosen, above any exposure."""
RETRY_S = 0.3
"""Pause between two attempts to open; an attempt itself takes seconds if nothing answers."""
CLOSE_S = 1.0
"""A responding camera closes within this time; one that does not respond is reopened meanwhile."""
LATEST = 0.2
"""A trigger that is late by this share of the period is skipped, so that the next one is on time. Chosen."""
RECEIVE_S = 0.1
"""Time for which a call waits for an image before it checks whether to stop."""


class OpenCamera(Protocol):
    """The interface of an opened camera."""

    broken: int

    @property
    def is_lost(self) -> bool:
        """Return whether the camera has stopped answering."""
        ...

    def receive(self, seconds: float) -> RawImage | None:
        """Return the next complete image; None if none arrives in time."""
        ...

    def trigger(self) -> bool:
        """Trigger an image; return whether the camera answered."""
        ...

    def set_exposure(self, exposure_us: float) -> bool:
        """Set the exposure time of the next images; return whether the camera answered."""
        ...

    def close(self) -> None:
        """Release the camera."""
        ...


@dataclass(frozen=True, slots=True)
class TriggerPace:
    """Instants of the software trigger, common to all cameras' threads."""

    start_s: float
    """time.monotonic() of one of the instants."""
    period_s: float

    def after(self, now_s: float) -> float:
        """Return the next instant after ``now_s``."""
        return self.start_s + ((now_s - self.start_s) // self.period_s + 1) * self.period_s


class CameraThreads:
    """Runs one camera; a call to a camera that is gone blocks for seconds, so each camera has its own threads."""

    def __init__(
        self,
        name: str,
        open_: Callable[[], OpenCamera],
        on_open: Callable[[str], None],
        on_image: Callable[[str, RawImage], None],
        is_overdue: Callable[[str, float], bool],
        pace: TriggerPace | None,
        on_exposure: Callable[[str, float, int], None],
    ) -> None:
        """``is_overdue(name, seconds without an image)``: whether to reopen; ``pace``: of software triggers.

        ``on_exposure(name, µs, time.monotonic_ns())`` is called when the camera has taken a new exposure time.
        """
        self._name = name
        self._on_exposure = on_exposure
        self.exposure_us: float | None = None
        """The exposure time to set, also after the camera was reopened; None: that of the settings."""
        self._set_us: float | None = None
        self._open, self._on_open, self._on_image, self._is_overdue = open_, on_open, on_image, is_overdue
        self._pace = pace
        self._stop = threading.Event()
        self._device: OpenCamera | None = None
        self._broken_before = 0
        self.trouble = ""
        """Why it cannot be opened; empty while it is open."""
        self._threads = [threading.Thread(target=self._run, name=f"camera {name}", daemon=True)]
        if pace is not None:
            self._threads.append(
                make_supervised_thread(
                    f"trigger {name}", self._trigger, self._on_trigger_failure, self._stop.wait
                )
            )
        for thread in self._threads:
            thread.start()

    @property
    def is_open(self) -> bool:
        """Return whether the camera is open and started."""
        return self._device is not None

    @property
    def broken(self) -> int:
        """Number of images since the start with missing packets."""
        device = self._device
        return self._broken_before + (0 if device is None else device.broken)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._run_session()
            except Exception as error:  # after any error of a driver the camera is opened again
                self.trouble = str(error).partition("\n")[0] or type(error).__name__
            if self.trouble:  # outside the handler, where the error no longer refers to the camera
                self._stop.wait(RETRY_S)

    def _run_session(self) -> None:
        device = self._open()
        self.trouble = ""
        self._set_us = None
        self._on_open(self._name)
        self._device = device
        try:
            self._receive(device)
        finally:
            self._device = None
            self._broken_before += device.broken
            # closing a camera that is gone takes ten seconds, and the camera may return before
            closing = threading.Thread(target=device.close, name=f"close {self._name}", daemon=True)
            closing.start()
            closing.join(CLOSE_S)

    def _receive(self, device: OpenCamera) -> None:
        last_s = time.monotonic()
        while not self._stop.is_set() and not device.is_lost:
            if self._pace is None:
                self._update_exposure(device)
            raw = device.receive(RECEIVE_S)
            if raw is not None:
                last_s = time.monotonic()
                self._on_image(self._name, raw)
            elif self._is_overdue(self._name, time.monotonic() - last_s):
                return

    def _on_trigger_failure(self, failure: str) -> None:
        self.trouble = f"its trigger failed: {failure}"

    def _trigger(self) -> None:
        assert self._pace is not None
        while not self._stop.is_set():
            instant_s = self._pace.after(time.monotonic())
            if self._stop.wait(max(0.0, instant_s - time.monotonic())):
                return
            device = self._device
            # a late trigger would not belong to the instant of the other cameras
            if device is not None and time.monotonic() - instant_s < LATEST * self._pace.period_s:
                self._update_exposure(device)  # between two images: the next one certainly has it
                device.trigger()

    def _update_exposure(self, device: OpenCamera) -> None:
        wanted = self.exposure_us
        if wanted is not None and wanted != self._set_us and device.set_exposure(wanted):
            self._set_us = wanted
            self._on_exposure(self._name, wanted, time.monotonic_ns())

    def stop(self) -> None:
        """Request the end of the threads; ``join`` waits for it."""
        self._stop.set()

    def join(self, seconds: float) -> None:
        """Wait for the threads; a thread that hangs in a call to a lost camera ends later by itself."""
        until = time.monotonic() + seconds
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))
