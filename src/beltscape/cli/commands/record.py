"""``beltscape record PROJECT --out CAPTURE``: takes images with the project's cameras, without a display."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.cli.arguments import require_positive
from beltscape.core.progress import Reporter

if TYPE_CHECKING:
    from beltscape.pipeline.recording.feed import FrameFeed
    from beltscape.pipeline.recording.project import RecordingProject
    from beltscape.pipeline.recording.shots import Trigger


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("project", type=Path, metavar="PROJECT", help="project.toml with the table [cameras]")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="CAPTURE", help="folder; shots are added to it"
    )
    parser.add_argument("--shots", type=int, metavar="N", help="number of shots, or of a sequence's frames")
    parser.add_argument(
        "--every", type=float, metavar="S", help="take a shot every S seconds instead of by key"
    )
    parser.add_argument(
        "--board", type=Path, metavar="FILE", help="board.toml: say how many corners each camera sees"
    )
    parser.add_argument(
        "--sequence", action="store_true", help="record every frame, with the belt's positions"
    )
    parser.add_argument(
        "--seconds", type=float, metavar="S", help="end a sequence after S seconds; else Ctrl-C ends it"
    )
    parser.add_argument("--image", choices=("png", "tiff"), default="png", help="file format; default: png")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Open the cameras and record; close them in any case."""
    from beltscape.core.errors import InputError
    from beltscape.files.camera_types import write_camera_types
    from beltscape.pipeline.recording.feed import FrameFeed
    from beltscape.pipeline.recording.project import list_camera_types, read_recording_project
    from beltscape.sources.genicam.aravis import find_cameras
    from beltscape.sources.genicam.source import open_cameras

    _require_sense(arguments)
    project = read_recording_project(arguments.project)
    if arguments.sequence and arguments.out.is_dir() and any(arguments.out.iterdir()):
        raise InputError(f"{arguments.out}: is not empty; a sequence needs a folder of its own")
    encoder = project.open_encoder()
    types = list_camera_types(project.cameras, find_cameras())
    source = open_cameras(project.cameras, project.core)
    interrupted = threading.Event()

    def interrupt(number: int, frame: object) -> None:
        interrupted.set()  # what was recorded so far is a result

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        feed = FrameFeed(source, encoder, interrupted)
        record = _record_sequence if arguments.sequence else _record_shots
        result = record(arguments, project, feed, reporter)
        if result["frames"]:
            write_camera_types(arguments.out, types)
        return {"capture": arguments.out, "cameras": list(source.cameras), **result}
    finally:
        signal.signal(signal.SIGINT, before)
        source.close()
        if encoder is not None:
            encoder.close()


def _require_sense(arguments: argparse.Namespace) -> None:
    from beltscape.core.errors import SettingsError

    if arguments.sequence and (arguments.every is not None or arguments.board is not None):
        raise SettingsError("--sequence records every frame; --every and --board are for single shots")
    if not arguments.sequence and arguments.seconds is not None:
        raise SettingsError("--seconds ends a sequence; give --sequence, or --shots for single shots")
    for name in ("every", "seconds", "shots"):
        require_positive(f"--{name}", getattr(arguments, name))


def _record_shots(
    arguments: argparse.Namespace, project: RecordingProject, feed: FrameFeed, reporter: Reporter
) -> Mapping[str, Any]:
    from beltscape.pipeline.recording.shots import record_shots
    from beltscape.sinks.recording import CaptureWriter
    from beltscape.target.board import read_board

    board = None if arguments.board is None else read_board(arguments.board)
    writer, cameras = CaptureWriter(arguments.out, arguments.image), tuple(project.cameras.devices)
    shots = record_shots(feed, cameras, _make_trigger(arguments), writer, reporter, board)
    return {"shots": [{"frame": one.frame, "corners": one.corners} for one in shots], "frames": len(shots)}


def _make_trigger(arguments: argparse.Namespace) -> Trigger:
    from beltscape.pipeline.recording.shots import KeyTrigger, TimedTrigger

    if arguments.every is not None:
        return TimedTrigger(arguments.every, arguments.shots or sys.maxsize)
    if arguments.shots and not sys.stdin.isatty():
        return TimedTrigger(0.0, arguments.shots)
    return KeyTrigger(shots=arguments.shots or 0)


def _record_sequence(
    arguments: argparse.Namespace, project: RecordingProject, feed: FrameFeed, reporter: Reporter
) -> Mapping[str, Any]:
    from beltscape.pipeline.recording.feed import record_sequence
    from beltscape.sinks.recording import CaptureWriter

    ends_s = time.monotonic() + (arguments.seconds or float("inf"))
    most = arguments.shots or sys.maxsize
    writer, cameras = CaptureWriter(arguments.out, arguments.image), tuple(project.cameras.devices)
    done = record_sequence(
        feed, cameras, lambda written: written >= most or time.monotonic() > ends_s, writer, reporter
    )
    return {"frames": done.frames, "incomplete": done.incomplete, "dropped": done.dropped,
            "without_position": done.without_position}  # fmt: skip


def summary(result: Mapping[str, Any]) -> str:
    """Return what was recorded, and the next step."""
    lines = [f"{result['frames']} frames of {', '.join(result['cameras'])} in {result['capture']}"]
    if "dropped" in result:
        lines.append(f"{result['incomplete']} incomplete, {result['dropped']} dropped")
    return "\n".join(lines)
