"""The newest frame sets of running cameras, with the encoder's position; and a sequence of all of them."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet
from beltscape.core.interfaces import LiveSource
from beltscape.core.progress import Reporter
from beltscape.core.supervision import make_supervised_thread
from beltscape.files.times_csv import append_time
from beltscape.sinks.recording import CaptureWriter
from beltscape.sources.encoder.opening import Encoder

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
        self._thread = make_supervised_thread("feed", self._collect, self._fail, interrupted.wait)
        self._thread.start()

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

    def join(self, wait_s: float) -> None:
        """Wait until the thread has ended, which it does with the source; at most ``wait_s``."""
        self._thread.join(wait_s)

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


_SEQUENCE_PATIENCE_S = 30.0
"""As for single shots."""


@dataclass(frozen=True, slots=True)
class Sequence:
    """A recorded sequence."""

    frames: int
    incomplete: int
    """Frame sets without the image of some camera."""
    without_position: int
    """Frame sets without the encoder's position."""
    dropped: int
    """Frame sets that the disk was too slow for."""


def record_sequence(
    feed: FrameFeed,
    cameras: tuple[str, ...],
    is_finished: Callable[[int], bool],
    writer: CaptureWriter,
    reporter: Reporter,
) -> Sequence:
    """Write every frame set until ``is_finished``, which is given the number of frame sets written.

    The first frame set is one of all cameras. Frame sets are numbered as they were triggered: a dropped one leaves
    a gap in the names.

    Raises
    ------
    InputError
        if no images come, or none of all cameras; it names the cameras that are not well.
    OSError
        if an image cannot be written.
    """
    begin_s = time.monotonic()
    written = incomplete = without_position = 0
    for frames in feed.iterate(_SEQUENCE_PATIENCE_S):
        if is_finished(written):
            break
        if frames is None:
            continue
        missing = [name for name in cameras if name not in frames.images]
        if missing and not written:  # cameras start one after another
            if time.monotonic() - begin_s > _SEQUENCE_PATIENCE_S:
                raise InputError(
                    f"no instant with all cameras for {_SEQUENCE_PATIENCE_S:.0f} s; {feed.describe_cameras()}"
                )
            continue
        numbered = replace(frames, frame=f"{written + feed.dropped:05d}")
        if not writer.can_append(numbered):
            reporter.warn(
                f"{numbered.frame}: the encoder ran back or its time did not grow; the frame is left out"
            )
            continue
        writer.write(numbered)
        if numbered.position_mm is None and numbered.time_ns is not None:  # else encoder.csv has its time
            append_time(writer.folder, numbered.frame, numbered.time_ns)
        written += 1
        incomplete += bool(missing)
        without_position += frames.position_mm is None
        reporter.step("recording", written, max(written, 1))
    if feed.dropped:
        reporter.warn(
            f"{feed.dropped} frame sets were dropped: the disk is too slow; record as TIFF, or on an SSD"
        )
    if without_position and written:
        reporter.warn(f"{without_position} of {written} frame sets have no belt position; check [encoder]")
    return Sequence(written, incomplete, without_position, feed.dropped)
