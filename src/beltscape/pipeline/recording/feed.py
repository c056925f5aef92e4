"""The newest frame sets of running cameras, with the encoder's position."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet
from beltscape.core.live.interfaces import LiveSource
from beltscape.core.runtime.supervision import make_supervised_thread
from beltscape.sources.encoder.protocol import Encoder

QUEUE = 32
"""Largest number of frame sets that wait to be written; beyond it the oldest are dropped and counted."""
_POLL_S = 0.05
"""Longest wait before the end of the recording is checked."""


class FrameFeed:
    """Collects the frame sets of a live source in a thread of its own."""

    def __init__(self, source: LiveSource, encoder: Encoder | None, interrupted: threading.Event) -> None:
        """Begin at once; ``interrupted`` ends the iteration from outside."""
        self._source, self._encoder, self._interrupted = source, encoder, interrupted
        self._waiting: deque[FrameSet] = deque()
        self._wake = threading.Condition()
        self._last_s = time.monotonic()
        self._closed = False
        self._failure = ""
        self.dropped = 0
        """Frame sets that were not written in time."""
        make_supervised_thread("feed", self._collect, self._fail, interrupted.wait).start()

    def _fail(self, reason: str) -> None:
        """Keep the reason; the source is iterated over again."""
        self._failure = reason

    def _collect(self) -> None:
        for frames in self._source:
            if self._encoder is not None and frames.position_mm is None:
                frames = replace(  # noqa: PLW2901
                    frames, position_mm=self._encoder.position_at(frames.time_ns, frames.frame)
                )
            with self._wake:
                self._waiting.append(frames)
                if len(self._waiting) > QUEUE:
                    self._waiting.popleft()
                    self.dropped += 1
                self._last_s = time.monotonic()
                self._wake.notify()
        with self._wake:
            self._closed = True
            self._wake.notify()

    def clear(self) -> None:
        """Forget the frame sets that wait: the next one is new."""
        with self._wake:
            self._waiting.clear()

    def iterate(self, patience_s: float) -> Iterator[FrameSet | None]:
        """Yield the frame sets in order, and None while there is none, until interrupted.

        Raises
        ------
        InputError
            if no frame set came for ``patience_s``; it names the cameras that are not well, and why.
        """
        while not self._interrupted.is_set():
            with self._wake:
                if not self._waiting and not self._closed:
                    self._wake.wait(_POLL_S)
                frames = self._waiting.popleft() if self._waiting else None
                silent_s = time.monotonic() - self._last_s
            if frames is None and self._closed:
                return
            if frames is None and silent_s > patience_s:
                raise InputError(f"no images for {patience_s:.0f} s; {self.describe_cameras()}")
            yield frames

    def describe_cameras(self) -> str:
        """Return the cameras that are not well, and why."""
        states = self._source.health()
        return (
            "; ".join(f"{name}: {one.message}" for name, one in states.items() if one.state != "ok")
            or "no fault"
        )
