"""One camera's threads: opened, listened to, triggered, opened again when it is lost."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from beltscape.sources.genicam.device import RawImage

REOPEN_AFTER_S = 1.5
"""Without an image where one was due, a camera is opened anew."""
RETRY_S = 0.3
"""Between two attempts; an attempt itself takes seconds where nothing answers."""
CLOSE_S = 1.0
"""A camera that answers is closed in this time; one that does not is opened anew meanwhile."""
LATEST = 0.2
"""A trigger that is late by this share of the period is left out."""
RECEIVE_S = 0.1
"""So long a call waits for an image before it looks whether it is to stop."""


class OpenCamera(Protocol):
    """What is needed of an opened camera."""

    broken: int

    @property
    def lost(self) -> bool:
        """Whether it does not answer any more."""
        ...

    def receive(self, seconds: float) -> RawImage | None:
        """The next whole image; None where none came in time."""
        ...

    def trigger(self) -> bool:
        """Have it take an image."""
        ...

    def close(self) -> None:
        """Give it back."""
        ...


@dataclass(frozen=True, slots=True)
class TriggerPace:
    """Instants of the software trigger: all cameras' threads have the same."""

    start_s: float
    """time.monotonic() of one of them."""
    period_s: float

    def after(self, now_s: float) -> float:
        """The next one."""
        return self.start_s + ((now_s - self.start_s) // self.period_s + 1) * self.period_s


class CameraThreads:
    """Keeps one camera going; a call to a dead camera blocks for seconds, so each has its own threads."""

    def __init__(
        self,
        name: str,
        open_: Callable[[], OpenCamera],
        on_open: Callable[[str], None],
        on_image: Callable[[str, RawImage], None],
        is_overdue: Callable[[str, float], bool],
        pace: TriggerPace | None,
    ) -> None:
        """``due(name, seconds without an image)`` says whether that is too long; ``pace``: of software triggers."""
        self._name = name
        self._open, self._on_open, self._on_image, self._is_overdue = open_, on_open, on_image, is_overdue
        self._pace = pace
        self._stop = threading.Event()
        self._device: OpenCamera | None = None
        self._broken_before = 0
        self.trouble = ""
        """Why it cannot be opened; empty while it is open."""
        self._threads = [threading.Thread(target=self._keep, name=f"camera {name}", daemon=True)]
        if pace is not None:
            self._threads.append(threading.Thread(target=self._trigger, name=f"trigger {name}", daemon=True))
        for thread in self._threads:
            thread.start()

    @property
    def is_open(self) -> bool:
        """Whether the camera was found and started."""
        return self._device is not None

    @property
    def broken(self) -> int:
        """Images since the start that came with packets missing."""
        device = self._device
        return self._broken_before + (0 if device is None else device.broken)

    def _keep(self) -> None:
        while not self._stop.is_set():
            try:
                self._run_session()
            except Exception as error:  # whatever a driver does, the camera is tried again
                self.trouble = str(error).partition("\n")[0] or type(error).__name__
            if self.trouble:  # by now the error is gone, and with it all it held of the camera
                self._stop.wait(RETRY_S)

    def _run_session(self) -> None:
        device = self._open()
        self.trouble = ""
        self._on_open(self._name)
        self._device = device
        try:
            self._receive(device)
        finally:
            self._device = None
            self._broken_before += device.broken
            # a dead camera takes ten seconds to give up, and may be back before
            closing = threading.Thread(target=device.close, name=f"close {self._name}", daemon=True)
            closing.start()
            closing.join(CLOSE_S)

    def _receive(self, device: OpenCamera) -> None:
        last_s = time.monotonic()
        while not self._stop.is_set() and not device.lost:
            raw = device.receive(RECEIVE_S)
            if raw is not None:
                last_s = time.monotonic()
                self._on_image(self._name, raw)
            elif self._is_overdue(self._name, time.monotonic() - last_s):
                return

    def _trigger(self) -> None:
        assert self._pace is not None
        while not self._stop.is_set():
            instant_s = self._pace.after(time.monotonic())
            if self._stop.wait(max(0.0, instant_s - time.monotonic())):
                return
            device = self._device
            # too late to be of one instant with the others: better none
            if device is not None and time.monotonic() - instant_s < LATEST * self._pace.period_s:
                device.trigger()

    def stop(self) -> None:
        """Ask the threads to end; ``join`` waits for it."""
        self._stop.set()

    def join(self, seconds: float) -> None:
        """Wait for the threads; one that hangs on a dead camera is left to end by itself."""
        until = time.monotonic() + seconds
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))
