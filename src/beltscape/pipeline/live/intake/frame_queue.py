"""The bounded queue of frame sets between the cameras and the worker; it drops the oldest when full."""

from __future__ import annotations

import threading
from collections import deque

from beltscape.core.frames import FrameSet


class FrameQueue:
    """Holds a few frame sets; when it is full, a new one displaces the oldest, which is counted.

    The belt of a dropped frame is not lost to the ledger: the next frame's strip extends back over it.
    """

    def __init__(self, capacity: int, *, blocking: bool = False) -> None:
        """``blocking``: ``put`` waits for room instead of dropping, as a recording allows."""
        self.dropped = 0
        """Frame sets dropped so far."""
        self._capacity, self._blocking = capacity, blocking
        self._waiting: deque[FrameSet] = deque()
        self._changed = threading.Condition()
        self._closed = False

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
            while len(self._waiting) >= self._capacity:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(frames)
            self._changed.notify_all()

    def get(self, seconds: float) -> FrameSet | None:
        """Remove and return the oldest; None if none arrives in time, or the queue is closed and empty."""
        with self._changed:
            if not self._waiting and not self._closed:
                self._changed.wait(seconds)
            if not self._waiting:
                return None
            frames = self._waiting.popleft()
            self._changed.notify_all()
            return frames

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
