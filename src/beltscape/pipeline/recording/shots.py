"""Single shots, such as views of the calibration board, triggered by a key or at a fixed interval.

The board's corners in the images are counted; how the board is printed is found from the images.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TextIO

from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.detection.detect_capture import (
    SURE_CORNERS,
    SURE_RATIO,
    list_variants,
    make_two_sided_detector,
)
from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.progress import Reporter
from beltscape.core.supervision import make_supervised_thread
from beltscape.core.system_calls import read_key
from beltscape.pipeline.recording.feed import FrameFeed
from beltscape.sinks.recording import CaptureWriter
from beltscape.sources.genicam.health import find_brightness_fault
from beltscape.target.board import Board


class Trigger(Protocol):
    """Says when the next shot is due, and when there are no more."""

    def is_due(self) -> bool:
        """Return whether a shot is due now; one that was returned is used up."""
        ...

    @property
    def is_finished(self) -> bool:
        """True if no further shot will be due."""
        ...


class TimedTrigger:
    """A shot at once, then one after each interval, up to a number of them."""

    def __init__(self, interval_s: float, shots: int) -> None:
        """``interval_s`` 0: every frame set."""
        self._interval_s, self._left = interval_s, shots
        self._next_s = time.monotonic()

    def is_due(self) -> bool:
        """See `Trigger`."""
        if self._left <= 0 or time.monotonic() < self._next_s:
            return False
        self._left -= 1
        self._next_s = time.monotonic() + self._interval_s
        return True

    @property
    def is_finished(self) -> bool:
        """See `Trigger`."""
        return self._left <= 0


class KeyTrigger:
    """A shot for each key: the space bar or Enter; q, Ctrl-D or the input's end finishes.

    On a terminal single keys are read; from a pipe, lines.
    """

    def __init__(self, stream: TextIO | None = None, shots: int = 0) -> None:
        """``shots`` limits their number; 0: no limit."""
        self._stream = sys.stdin if stream is None else stream
        self._limit, self._asked, self._taken = shots, 0, 0
        self._ended = threading.Event()
        make_supervised_thread("keys", self._read, self._end, self._ended.wait).start()

    def _end(self, reason: str) -> None:  # noqa: ARG002
        """End with what was taken, such as where the terminal is gone."""
        self._ended.set()

    def _read(self) -> None:
        is_terminal = self._stream.isatty()
        while key := read_key(self._stream) if is_terminal else self._stream.readline():
            if key.strip().lower() in ("q", "\x04", "\x03"):
                break
            self._asked += 1
        self._ended.set()

    def is_due(self) -> bool:
        """See `Trigger`."""
        if self._taken >= self._asked or self.is_finished:
            return False
        self._taken += 1
        return True

    @property
    def is_finished(self) -> bool:
        """See `Trigger`."""
        has_all = self._limit > 0 and self._taken >= self._limit
        return has_all or (self._ended.is_set() and self._taken >= self._asked)


class CornerCounter:
    """Counts the corners of a board in the images of each shot.

    Keys that board.toml leaves open (``legacy``, ``inverted``) are tried until the shots decide between them.
    """

    def __init__(self, board: Board) -> None:
        self._detectors = [make_two_sided_detector(board, variant) for variant in list_variants(board)]
        self._totals = [0] * len(self._detectors)

    def count(self, images: Mapping[str, Image]) -> dict[str, int]:
        """Return the number of corners by camera, from the front or from behind, under the best print variant."""
        corners = self.detect(images)
        return {name: len(corners.get(name, ())) for name in images}

    def detect(self, images: Mapping[str, Image]) -> dict[str, Corners]:
        """Return the corners by camera under the best print variant; a camera that sees none is absent."""
        found: list[dict[str, Corners]] = []
        for detect in self._detectors:
            corners = {name: detect(image) for name, image in images.items()}
            found.append({name: own for name, own in corners.items() if own})
        counts = [sum(map(len, own.values())) for own in found]
        self._totals = [total + count for total, count in zip(self._totals, counts, strict=True)]
        best = max(range(len(found)), key=lambda i: self._totals[i])
        others = [total for i, total in enumerate(self._totals) if i != best]
        if self._totals[best] >= SURE_CORNERS and self._totals[best] > SURE_RATIO * max(others, default=0):
            self._detectors, self._totals = [self._detectors[best]], [self._totals[best]]
        return found[best]


_PATIENCE_S = 30.0
"""Cameras answer within some seconds; after a loss they are reopened within ten."""
_TRIES = 3
"""Frame sets in a row that may lack a camera after a shot was asked for, before it is given up."""


@dataclass(frozen=True, slots=True)
class Shot:
    """One recorded frame set."""

    frame: str
    cameras: tuple[str, ...]
    corners: dict[str, int]
    """By camera: corners of the board that are found; empty without a board."""

    def describe(self) -> str:
        """Return it in one line."""
        seen = ", ".join(f"{name} {count}" for name, count in self.corners.items())
        return f"{self.frame}: {len(self.cameras)} cameras" + (f"; corners: {seen}" if seen else "")


def record_shots(
    feed: FrameFeed,
    cameras: tuple[str, ...],
    trigger: Trigger,
    writer: CaptureWriter,
    reporter: Reporter,
    board: Board | None = None,
) -> list[Shot]:
    """Write a frame set of all cameras each time the trigger is due; return them.

    A shot that lacks a camera's image is tried again with the next frame sets, then given up with a warning.

    Raises
    ------
    InputError
        if no images come, or the times or positions of a capture that is there lie after those of the first shot.
    OSError
        if an image cannot be written.
    """
    writer.resume()
    count_corners = CornerCounter(board) if board else None
    shots: list[Shot] = []
    number, tries = find_next_number(writer.folder), 0
    for frames in feed.iterate(_PATIENCE_S):
        if trigger.is_finished and not tries:
            break
        if not tries and trigger.is_due():
            tries = _TRIES
            feed.clear()
            continue
        if frames is None or not tries:
            continue
        missing = [name for name in cameras if name not in frames.images]
        if missing:
            tries -= 1
            if not tries:
                reporter.warn(f"no shot: {', '.join(missing)} gave no image; {feed.describe_cameras()}")
            continue
        tries = 0
        frames = replace(frames, frame=f"{number:03d}")  # noqa: PLW2901
        if not writer.can_append(frames):
            _report_break(writer, frames, bool(shots), reporter)
            continue
        shot = _write_shot(frames, writer, count_corners, reporter)
        shots.append(shot)
        number += 1
        reporter.step(shot.describe(), len(shots), len(shots))
    return shots


def _report_break(writer: CaptureWriter, frames: FrameSet, is_running: bool, reporter: Reporter) -> None:
    """Warn of a shot whose time or belt position runs back; raise InputError for the first one of a session."""
    line = writer.describe_break(frames)
    if not is_running:
        raise InputError(
            f"{line}: the machine or the encoder was started anew in between, and a capture's times and positions "
            "must grow; give another folder with --out"
        )
    reporter.warn(f"{line}: the belt ran back; the shot is left out")


def _write_shot(
    frames: FrameSet, writer: CaptureWriter, count_corners: CornerCounter | None, reporter: Reporter
) -> Shot:
    writer.write(frames)
    for name, image in frames.images.items():
        if fault := find_brightness_fault(image):
            reporter.warn(f"{frames.frame}: {name} is {fault}")
    corners = count_corners.count(frames.images) if count_corners else {}
    return Shot(frames.frame, tuple(frames.images), corners)


def find_next_number(folder: Path) -> int:
    """Return the number after the last numbered image of a capture folder; 0 for an empty one."""
    numbers = [int(path.stem) for path in folder.glob("*/*.*") if path.stem.isdecimal()]
    return max(numbers, default=-1) + 1
