"""Cameras in memory: a live source that gives prepared frame sets at a steady pace."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence

from beltscape.core.events import CameraHealth
from beltscape.core.frames import FrameSet


class MemoryCameras:
    """Gives the frame sets one after another, then nothing until it is closed."""

    def __init__(self, sets: Sequence[FrameSet], period_s: float = 0.01) -> None:
        self._sets, self._period_s, self._closed = sets, period_s, threading.Event()
        self.cameras = ("cam0", "cam1")

    def __iter__(self) -> Iterator[FrameSet]:
        for one in self._sets:
            if self._closed.is_set():
                return
            time.sleep(self._period_s)
            yield one
        self._closed.wait()

    def health(self) -> Mapping[str, CameraHealth]:
        fine = CameraHealth("cam0", "ok", 1, 0, 8.0, 0.0)
        return {
            "cam0": fine,
            "cam1": CameraHealth("cam1", "lost", 0, 9, 0.0, 0.0, "lost: check power, cable"),
        }

    def close(self) -> None:
        self._closed.set()
