"""Recording of raw frame sets to disk while the system runs, without delaying it."""

from __future__ import annotations

import shutil
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.frames import FrameSet
from beltscape.core.supervision import make_supervised_thread
from beltscape.sinks.recording import PARTS, CaptureStore, CaptureWriter, Ring
from beltscape.sinks.settings import GIB, RecordingSettings

_CHECK_S = 1.0
"""Interval between checks of the disk; a recording fills some hundred MB meanwhile."""


@dataclass(frozen=True, slots=True)
class RecorderState:
    """State of the recording."""

    mode: str
    written: int
    """Frame sets written since the start."""
    dropped: int
    """Frame sets skipped since the start because the queue or the disk was full."""
    waiting: int
    """Frame sets in the queue."""
    size_bytes: int
    """Size of all recordings."""
    trouble: str
    """Why recording pauses, in one line; empty while it does not."""


class Recorder:
    """Writes frame sets in a thread of its own; frame sets that it cannot write in time are skipped and counted."""

    def __init__(self, folder: Path, settings: RecordingSettings) -> None:
        """Record captures below ``folder``, which is created with the first frame set."""
        self._folder, self._settings = folder, settings
        self._store = CaptureStore(folder)
        self._ring = self._make_ring()
        self._queue: deque[FrameSet | Path | RecordingSettings] = deque()
        self._wake = threading.Condition()
        self._closing = False
        self._capture: CaptureWriter | None = None
        self._capture_start_s = self._checked_s = float("-inf")
        self._written = self._dropped = 0
        self._trouble = ""
        self._check_folder()
        self._thread = make_supervised_thread("recorder", self._run, self._on_failure, self._wait_to_stop)
        self._thread.start()

    @property
    def trouble(self) -> str:
        """Why recording pauses, in one line; empty while it does not."""
        return self._trouble

    @property
    def state(self) -> RecorderState:
        """State of the recording; from any thread."""
        with self._wake:
            return RecorderState(
                mode=self._settings.mode,
                written=self._written,
                dropped=self._dropped,
                waiting=self._waiting(),
                size_bytes=self._store.size_bytes,
                trouble=self._trouble,
            )

    def take(self, frames: FrameSet) -> None:
        """Queue a frame set for recording; return at once. The images must not be changed afterwards."""
        if self._settings.mode == "off":
            return
        with self._wake:
            if self._closing or self._waiting() >= self._settings.queue:
                self._dropped += 1
                return
            self._queue.append(frames)
            self._wake.notify()

    def keep(self, reason: str) -> Path | None:
        """Keep the ring's content up to the last frame set; return the capture that will hold it.

        None without a ring, or with an empty one.
        """
        with self._wake:
            if self._settings.mode != "ring" or self._closing or not (self._ring or self._waiting()):
                return None
            if not self._store.is_scanned:  # no number is known that is free
                return None
            target = self._store.new_path("kept", reason)
            self._queue.append(target)
            self._wake.notify()
            return target

    def set_settings(self, settings: RecordingSettings) -> None:
        """Record by other settings after the frame sets that are queued; what is recorded stays."""
        with self._wake:
            self._queue.append(settings)
            self._wake.notify()

    def close(self) -> None:
        """Write the queued frame sets, then end."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()

    def _waiting(self) -> int:
        return sum(isinstance(item, FrameSet) for item in self._queue)

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._queue or self._closing)
                if not self._queue:
                    return
                item = self._queue[0]
            try:
                if isinstance(item, FrameSet):
                    self._record(item)
                elif isinstance(item, RecordingSettings):
                    self._settings, self._capture = item, None
                    self._ring = self._make_ring()
                    self._check_folder()
                else:
                    self._keep(item)
            finally:  # what fails is not tried again: the next frame set is as good
                with self._wake:
                    self._queue.popleft()

    def _make_ring(self) -> Ring:
        return Ring(self._store, self._settings.ring_min * 60, time.monotonic())

    def _on_failure(self, failure: str) -> None:
        """Report an unexpected error; recording goes on with the next frame set."""
        self._trouble = f"{self._folder}: recording failed ({failure}) and starts again"
        with self._wake:
            self._dropped += 1

    def _wait_to_stop(self, seconds: float) -> bool:
        with self._wake:
            return self._wake.wait_for(lambda: self._closing, seconds)

    def _describe(self, error: OSError) -> str:
        reason = error.strerror or str(error)
        return f"{self._folder}: recording pauses ({reason}); free some space, or correct its permissions"

    def _record(self, frames: FrameSet) -> None:
        """Write one frame set, or count it as skipped and set ``trouble``."""
        now = time.monotonic()
        if now - self._checked_s >= _CHECK_S:
            self._checked_s = now
            self._check_folder()
        size = 0
        try:
            size = 0 if self._trouble else self._capture_for(frames, now).write(frames)
        except OSError as error:
            self._trouble = self._describe(error)
        if not self._trouble and self._capture is not None:
            self._store.add_size(self._capture.folder, size)
        with self._wake:
            self._written += not self._trouble
            self._dropped += bool(self._trouble)

    def _capture_for(self, frames: FrameSet, now_s: float) -> CaptureWriter:
        """Return the capture for a frame set: the current one, or a new one."""
        settings = self._settings
        length_min = settings.ring_min / PARTS if settings.mode == "ring" else settings.capture_min
        is_continuation = self._capture is not None and self._capture.can_append(frames)
        if self._capture is None or not is_continuation or now_s - self._capture_start_s >= length_min * 60:
            with self._wake:
                folder = self._store.new_path(settings.mode)
            self._capture = CaptureWriter(folder, settings.image)
            self._capture_start_s = now_s
            if settings.mode == "ring":
                self._ring.add(folder, now_s, is_continuation=is_continuation)
        return self._capture

    def _keep(self, target: Path) -> None:
        self._capture = None
        try:
            self._ring.keep(target)
        except OSError as error:
            self._trouble = f"{target}: cannot be kept ({error.strerror or error})"

    def _check_folder(self) -> None:
        """Set ``trouble`` if the folder cannot be used now, else clear it and make room."""
        try:
            if not self._store.is_scanned:
                self._store.scan()
                self._ring = self._make_ring()
            self._trouble = "" if self._settings.mode == "off" else self._make_room()
        except OSError as error:
            self._trouble = self._describe(error)

    def _make_room(self) -> str:
        """Remove the oldest captures that are not kept; return why space is still short, or an empty text."""
        limit, least = self._settings.limit_gib * GIB, self._settings.free_gib * GIB
        if self._store.size_bytes > limit:
            self._store.refresh()
        while self._store.size_bytes > limit or _free(self._folder) < least:
            if not self._remove_oldest():
                break
        if self._store.size_bytes > limit:
            return (
                f"{self._folder}: recording pauses: kept captures take {self._store.kept_bytes / GIB:.1f} of "
                f"{self._settings.limit_gib:g} GiB; remove those that are no longer needed from kept/"
            )
        if (free := _free(self._folder)) < least:
            return (
                f"{self._folder}: recording pauses: {free / GIB:.1f} GiB are free, {self._settings.free_gib:g} must "
                "stay (free_gib); free some space"
            )
        return ""

    def _remove_oldest(self) -> bool:
        """Remove the oldest capture; return False if only kept ones and the one being written are left."""
        current = None if self._capture is None else self._capture.folder
        oldest = next((path for path in self._store.list_captures("all") if path != current), None)
        if oldest is None:
            return self._ring.drop_oldest()
        self._store.remove(oldest)
        return True


def _free(folder: Path) -> int:
    """Return the free bytes on the disk of a folder, which need not exist."""
    while not folder.is_dir():
        folder = folder.parent
    return shutil.disk_usage(folder).free
