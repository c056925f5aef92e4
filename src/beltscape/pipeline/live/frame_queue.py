"""Between the cameras and the worker: short, newest first."""

from __future__ import annotations

import threading
from collections import deque

from beltscape.core.frames import FrameSet


class FrameQueue:
    """Holds a few frame sets; where a further one finds no room, the oldest goes and is counted.

    What was dropped is not lost to the ledger: the next frame's strip reaches back over it.
    """

    def __init__(self, room: int, *, patient: bool = False) -> None:
        """``patient``: whoever brings one waits for room instead, as a recording can."""
        self.dropped = 0
        """Frame sets left out so far."""
        self._room, self._patient = room, patient
        self._waiting: deque[FrameSet] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def closed(self) -> bool:
        """Whether no more come and all were taken."""
        return self._closed and not self._waiting

    def put(self, frames: FrameSet) -> None:
        """Bring one."""
        with self._changed:
            while self._patient and len(self._waiting) >= self._room and not self._closed:
                self._changed.wait()
            if self._closed:
                return
            if len(self._waiting) >= self._room:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(frames)
            self._changed.notify_all()

    def get(self, seconds: float) -> FrameSet | None:
        """Take the one that waits longest; None where none comes in time, or none comes any more."""
        with self._changed:
            if not self._waiting and not self._closed:
                self._changed.wait(seconds)
            if not self._waiting:
                return None
            frames = self._waiting.popleft()
            self._changed.notify_all()
            return frames

    def close(self) -> None:
        """No more come; those that wait can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
