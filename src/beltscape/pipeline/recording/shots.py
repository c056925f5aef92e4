"""Single shots, such as views of the calibration board."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.pipeline.recording.corner_counter import CornerCounter
from beltscape.pipeline.recording.feed import FrameFeed
from beltscape.pipeline.recording.trigger import Trigger
from beltscape.sinks.recording.capture_writer import CaptureWriter
from beltscape.sources.genicam.health import find_brightness_fault
from beltscape.target.board import Board

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
