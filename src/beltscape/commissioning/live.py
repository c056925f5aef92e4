"""What the cameras see now: the source of a commissioning's pictures, and the newest of them.

A folder of captures, or the trial plant, stands for cameras (`staged_cameras`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from beltscape.commissioning import trial
from beltscape.commissioning.project_text import write_cameras
from beltscape.commissioning.staged_cameras import CarriedBoard, StagedCameras
from beltscape.commissioning.state import CommissionState
from beltscape.commissioning.steps import CAMERAS_FILE, VIEWS, find_capture
from beltscape.core.errors import BeltscapeError, InputError
from beltscape.core.events import CameraHealth
from beltscape.core.frames import FrameSet, Image
from beltscape.core.interfaces import LiveSource
from beltscape.core.supervision import make_supervised_thread
from beltscape.files.capture import read_capture
from beltscape.pipeline.recording.feed import FrameFeed

_PATIENCE_S = 20.0
"""Longest wait for an instant with all cameras: one that was restarted takes seconds to come back."""
_CLOSE_S = 10.0
"""Longest wait for the thread that reads a source after this was closed: one picture of a board."""
_PICTURE_PX = 640
"""Longer side of a picture for the page."""


_CARRY_S = 20.0
"""Longest wait of a carried board for its view to be looked at: a busy machine takes seconds."""


def open_source(state: CommissionState) -> LiveSource:
    """Open the cameras, or the capture that stands for them; InputError where there are none yet."""
    settings = state.settings
    if settings.source is None:
        raise InputError("no cameras yet: finish the step cameras first")
    if settings.source == "trial" and (board := trial.open_board(state)) is not None:
        return board
    if settings.source != "cameras":
        return CarriedBoard(read_capture(state.folder / find_capture(settings, VIEWS)))
    write_cameras(state)
    from beltscape.pipeline.recording.project import read_recording_project
    from beltscape.sources.genicam.source import open_cameras

    project = read_recording_project(state.folder / CAMERAS_FILE)
    return open_cameras(project.cameras, settings.core or project.core)


def collect_complete(source: LiveSource, count: int, interrupted: threading.Event) -> list[FrameSet]:
    """Return the next frame sets of all cameras, and close the source.

    Raises
    ------
    InputError
        Where there are none for `_PATIENCE_S`; it names the cameras that are not well, and why.
    """
    feed = FrameFeed(source, None, interrupted)
    try:
        return _collect_complete(feed, source.cameras, count)
    finally:
        source.close()
        feed.join(_CLOSE_S)  # a program must not end while a thread draws a board


def _collect_complete(feed: FrameFeed, cameras: tuple[str, ...], count: int) -> list[FrameSet]:
    complete = list[FrameSet]()
    until_s = time.monotonic() + _PATIENCE_S
    for frames in feed.iterate(_PATIENCE_S):
        if frames is not None and set(frames.images) == set(cameras):
            complete.append(frames)
            until_s = time.monotonic() + _PATIENCE_S
        if len(complete) == count:
            return complete
        if time.monotonic() > until_s:
            raise InputError(
                f"no instant with all cameras for {_PATIENCE_S:.0f} s; {feed.describe_cameras()}"
            )
    if not complete:
        raise InputError("no images: the source ended, or the step was cancelled")
    return complete


class LiveView:
    """Keeps the newest frame set of a source, in a thread of its own, while it is open."""

    def __init__(self, opener: Callable[[], LiveSource]) -> None:
        self._opener = opener
        self._lock = threading.Condition()
        self._frames: FrameSet | None = None
        self._source: LiveSource | None = None
        self._thread: threading.Thread | None = None
        self._assessed = ""
        self._has_consumer = False
        self.trouble = ""
        """Why there are no pictures, in one line; empty: there are."""

    @property
    def is_open(self) -> bool:
        """True while the source is open."""
        return self._source is not None

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras; empty while the source is closed."""
        source = self._source
        return () if source is None else source.cameras

    def list_faults(self) -> list[CameraHealth]:
        """Return the states of the cameras that are not well, such as one that was unplugged."""
        source = self._source
        return [] if source is None else [one for one in source.health().values() if one.state != "ok"]

    @property
    def source(self) -> LiveSource | None:
        """The source while it is open."""
        return self._source

    def open(self) -> None:
        """Open the source if it is closed; ``trouble`` says why that fails."""
        with self._lock:
            if self._source is not None:
                return
            self.trouble, self._frames = "", None
            try:
                source = self._source = self._opener()
            except BeltscapeError as error:
                self.trouble = str(error)
                return
        collect = lambda: self._collect(source)  # noqa: E731
        self._thread = make_supervised_thread("live view", collect, self._fail, lambda _: True)
        self._thread.start()

    def _fail(self, reason: str) -> None:
        self.trouble = reason

    def _collect(self, source: LiveSource) -> None:
        for frames in source:
            with self._lock:
                if source is not self._source:
                    return
                self._frames = frames
                self._lock.notify_all()
                if self._has_consumer and isinstance(source, StagedCameras):
                    # the carried board of the trial waits until the view was looked at
                    self._lock.wait_for(
                        lambda f=frames: self._assessed == f.frame or self._source is None, _CARRY_S
                    )

    def take_next(self, last: str, wait_s: float) -> FrameSet | None:
        """Return the newest frame set once it is no longer ``last``, which was assessed; None after ``wait_s``."""
        with self._lock:
            self._has_consumer, self._assessed = True, last
            self._lock.notify_all()
            self._lock.wait_for(lambda: self._frames is not None and self._frames.frame != last, wait_s)
            return None if self._frames is None or self._frames.frame == last else self._frames

    def take(self, wait_s: float = 0.0) -> FrameSet | None:
        """Return the newest frame set; None if none came within ``wait_s``."""
        with self._lock:
            if self._frames is None and wait_s:
                self._lock.wait_for(lambda: self._frames is not None, wait_s)
            return self._frames

    def close(self) -> None:
        """Close the source, so that a command can open the cameras."""
        with self._lock:
            source, self._source, self._frames = self._source, None, None
            self._has_consumer, self._assessed = False, ""
            self._lock.notify_all()
        if source is not None:
            source.close()
        if self._thread is not None:
            self._thread.join(_CLOSE_S)

    def encode_picture(self, camera: str) -> bytes | None:
        """Return a camera's newest picture as JPEG; None while there is none."""
        frames = self.take()
        image = None if frames is None else frames.images.get(camera)
        return None if image is None else encode_jpeg(image)


def encode_jpeg(image: Image) -> bytes:
    """Return an image as JPEG of at most `_PICTURE_PX`."""
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    scale = _PICTURE_PX / max(image.shape[:2])
    if scale < 1:
        image = np.asarray(
            cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
        )
    bgr = image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1])
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()


def prove_instants(folder: Path, core: str) -> dict[str, Any]:
    """Return how many instants a recorded capture has, how many lack an image, and how many each camera lacks."""
    capture = read_capture(folder)
    incomplete = sum(any(frame not in own for own in capture.files.values()) for frame in capture.frames)
    if core and core not in capture.cameras:
        raise InputError(f"{folder}: no camera {core} in it; it has {', '.join(capture.cameras)}")
    lacking = {name: len(set(capture.frames) - own.keys()) for name, own in capture.files.items()}
    facts: dict[str, Any] = {"instants": len(capture.frames), "incomplete": incomplete}
    return (
        {**facts, "lacking": {key: count for key, count in lacking.items() if count}} if incomplete else facts
    )
