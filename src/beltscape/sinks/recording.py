"""Recorded captures on disk: the one being written, a ring of the last minutes, and kept ones.

A capture is written frame set by frame set. The folder of captures keeps their order and sizes; of the ring's short
captures the oldest is removed.
"""

from __future__ import annotations

import os
import re
import shutil
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from beltscape.core.frames import FrameSet, Image
from beltscape.files.csv_table import append_rows
from beltscape.files.encoder_csv import HEADER, read_encoder
from beltscape.files.exposures_csv import FILE as EXPOSURES
from beltscape.files.exposures_csv import HEADER as EXPOSURES_HEADER
from beltscape.files.exposures_csv import format_exposures
from beltscape.files.times_csv import format_seconds

ENCODER = "encoder.csv"
ENCODER_HEADER = ",".join(HEADER)
_HOW = {
    "tiff": [cv2.IMWRITE_TIFF_COMPRESSION, 1],  # none
    "png": [],  # OpenCV's default, run lengths: three times as fast as level 1, and no larger
}


class CaptureWriter:
    """Writes ``<folder>/<camera>/<frame>.<ext>``, ``encoder.csv`` and ``exposures.csv``; complete files only."""

    def __init__(self, folder: Path, image: str) -> None:
        """``image`` is "tiff" or "png"; the folder is created with the first frame set."""
        self.folder = folder
        self._image = image
        self._time_ns: int | None = None
        self._position_mm: float | None = None
        self._frames: set[str] = set()

    @property
    def frames(self) -> int:
        """Number of frame sets written."""
        return len(self._frames)

    def resume(self) -> None:
        """Continue a capture that is there: its last time and position are those that the next frame set must follow.

        Raises
        ------
        InputError
            When its encoder.csv is not valid.
        """
        truncate_partial_line(self.folder / EXPOSURES)
        path = self.folder / ENCODER
        if path.exists():
            truncate_partial_line(path)
            for last in read_encoder(path)[-1:]:
                self._time_ns, self._position_mm = last.time_ns, last.belt_position_mm

    def describe_break(self, frames: FrameSet) -> str:
        """Return how a frame set that cannot be appended breaks the order of this capture."""
        before, after = (format_seconds(time_ns or 0) for time_ns in (self._time_ns, frames.time_ns))
        return (
            f"{self.folder / ENCODER}: ends at {before} s and {self._position_mm} mm, the next frame set is of "
            f"{after} s and {frames.position_mm} mm"
        )

    def can_append(self, frames: FrameSet) -> bool:
        """Return whether a frame set fits into this capture: a new name, increasing time, no reversed belt."""
        return (
            frames.frame not in self._frames
            and (self._time_ns is None or frames.time_ns is None or frames.time_ns > self._time_ns)
            and (
                self._position_mm is None
                or frames.position_mm is None
                or frames.position_mm >= self._position_mm
            )
        )

    def write(self, frames: FrameSet) -> int:
        """Write one frame set; return the bytes written. After an OSError nothing of it is left."""
        written: list[Path] = []
        try:
            size = 0
            for camera, image in frames.images.items():
                path = self.folder / camera / f"{frames.frame}.{self._image}"
                written.append(path)
                size += _write(path, encode(image, self._image))
            size += self._write_exposures(frames) + self._write_reading(frames)
        except OSError:
            for path in written:
                path.unlink(missing_ok=True)
            raise
        self._frames.add(frames.frame)
        self._time_ns = frames.time_ns if frames.time_ns is not None else self._time_ns
        self._position_mm = frames.position_mm if frames.position_mm is not None else self._position_mm
        return size

    def _write_reading(self, frames: FrameSet) -> int:
        """Write the row of encoder.csv if time and position are known, also for an instant without an image."""
        if frames.time_ns is None or frames.position_mm is None:
            return 0
        self.folder.mkdir(parents=True, exist_ok=True)
        line = f"{frames.frame},{format_seconds(frames.time_ns)},{float(frames.position_mm)!r}\n"
        return append_rows(self.folder / ENCODER, ENCODER_HEADER, line.encode())

    def _write_exposures(self, frames: FrameSet) -> int:
        """Write the rows of exposures.csv where the exposure times are known."""
        rows = format_exposures(frames)
        return append_rows(self.folder / EXPOSURES, ",".join(EXPOSURES_HEADER), rows.encode()) if rows else 0


def truncate_partial_line(path: Path) -> None:
    """Remove an incomplete last row of a table, such as after a power failure."""
    data = path.read_bytes() if path.exists() else b""
    whole = data[: data.rfind(b"\n") + 1]
    if whole != data:
        path.write_bytes(whole)


def encode(image: Image, how: str) -> bytes:
    """Encode an image as TIFF without compression or as PNG; both are lossless."""
    bgr = image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1])
    return cv2.imencode(f".{how}", bgr, _HOW[how])[1].tobytes()


def _write(path: Path, data: bytes) -> int:
    """Write a file under a hidden name first, so that a crash leaves no incomplete image; return its size."""
    temporary = path.with_name(f".{path.name}.part")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    return len(data)


_PART = ".part"


class CaptureStore:
    """The folder of recordings: ``ring/``, ``all/`` and ``kept/``, each with captures named in order.

    A capture's name is an increasing number and the wall clock; only the number defines the order.
    """

    def __init__(self, folder: Path) -> None:
        """Create the store; ``scan`` lists what the folder holds."""
        self.folder = folder
        self._sizes: dict[Path, int] = {}
        self._next = 1
        self.is_scanned = False
        """Whether the folder was listed; before, numbers of captures are not known."""

    def scan(self) -> None:
        """List the captures of earlier runs and finish their interrupted moves; OSError if they cannot be read."""
        for place in ("ring", "all", "kept"):
            _require_listable(self.folder / place)
            for capture in _captures(self.folder / place):
                self._sizes[capture] = _size(capture)
        for part in (self.folder / "kept").glob(f"*{_PART}"):
            self._sizes[_finish_move(part)] = _size(part.with_suffix(""))
        for capture in [*self.list_captures("ring"), *self.list_captures("all")[-1:]]:
            truncate_partial_line(capture / ENCODER)
        self._next = 1 + max((_number(path) for path in self._sizes), default=0)
        self.is_scanned = True

    @property
    def size_bytes(self) -> int:
        """Size of all captures."""
        return sum(list(self._sizes.values()))

    @property
    def kept_bytes(self) -> int:
        """Size of the kept captures."""
        return sum(size for path, size in list(self._sizes.items()) if path.parent.name == "kept")

    def list_captures(self, place: str) -> list[Path]:
        """Return the captures at "ring", "all" or "kept", oldest first."""
        return sorted((p for p in list(self._sizes) if p.parent.name == place), key=_number)

    def new_path(self, place: str, reason: str = "") -> Path:
        """Return the path of the next capture, which is not created."""
        words = re.sub(r"[^\w.-]+", "-", reason).strip("-.")[:40]
        stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        name = f"{self._next:06d}-{stamp}" + (f"-{words}" if words else "")
        self._next += 1
        return self.folder / place / name

    def add_size(self, capture: Path, size: int) -> None:
        """Add to the size of a capture."""
        self._sizes[capture] = self._sizes.get(capture, 0) + size

    def refresh(self) -> None:
        """Forget captures that were removed by others."""
        for capture in [path for path in self._sizes if not path.is_dir()]:
            del self._sizes[capture]

    def remove(self, capture: Path) -> None:
        """Delete a capture."""
        shutil.rmtree(capture, ignore_errors=True)
        self._sizes.pop(capture, None)

    def merge(self, captures: list[Path], target: Path) -> None:
        """Move consecutive captures into one, which gets its name only when it is complete."""
        part = target.with_name(target.name + _PART)
        part.mkdir(parents=True, exist_ok=True)
        for capture in captures:
            for camera in (p for p in sorted(capture.iterdir()) if p.is_dir()):
                (part / camera.name).mkdir(exist_ok=True)
                for image in camera.iterdir():
                    image.replace(part / camera.name / image.name)
            if (capture / ENCODER).exists():
                rows = (capture / ENCODER).read_bytes().split(b"\n", 1)[1]
                append_rows(part / ENCODER, ENCODER_HEADER, rows)
            size = self._sizes.get(capture, 0)
            self.remove(capture)
            self.add_size(target, size)
        part.replace(target)


def _require_listable(folder: Path) -> None:
    """Raise OSError if a folder that exists cannot be listed, which ``Path.glob`` hides."""
    with suppress(FileNotFoundError, NotADirectoryError):
        os.scandir(folder).close()


def _captures(place: Path) -> Iterator[Path]:
    return (p for p in place.glob("*") if p.is_dir() and _number(p) and p.suffix != _PART)


def _finish_move(part: Path) -> Path:
    """Finish a move that a crash interrupted: the images moved so far become a capture."""
    return part.replace(part.with_suffix(""))


def _number(capture: Path) -> int:
    match = re.match(r"\d+", capture.name)
    return int(match[0]) if match else 0


def _size(capture: Path) -> int:
    return sum(p.stat().st_size for p in capture.rglob("*") if p.is_file())


PARTS = 12
"""Number of pieces of the ring, of which one is removed at a time: it holds 11/12 of its length or more."""


@dataclass(frozen=True, slots=True)
class RingPiece:
    """A short capture in the ring."""

    folder: Path
    start_s: float
    """Beginning on a monotonic clock."""
    is_continuation: bool
    """True if it belongs to the same capture as the piece before."""


class Ring:
    """The pieces of the ring in the order of recording."""

    def __init__(self, store: CaptureStore, reach_s: float, now_s: float) -> None:
        """Take over an earlier run's pieces as if recorded now; they are removed after the ring's length."""
        self._store, self._reach_s = store, reach_s
        self._pieces = deque(
            RingPiece(folder, now_s, is_continuation=False) for folder in store.list_captures("ring")
        )

    def __bool__(self) -> bool:
        return bool(self._pieces)

    def add(self, folder: Path, now_s: float, *, is_continuation: bool) -> None:
        """Add a new piece; remove those older than the ring's length."""
        self._pieces.append(RingPiece(folder, now_s, is_continuation))
        # a piece ends where the next one begins
        while len(self._pieces) > 1 and self._pieces[1].start_s < now_s - self._reach_s:
            self.drop_oldest()

    def drop_oldest(self) -> bool:
        """Remove the oldest piece, except the one being written; return whether there was one."""
        if len(self._pieces) < 2:
            return False
        self._store.remove(self._pieces.popleft().folder)
        return True

    def keep(self, target: Path) -> None:
        """Move all pieces to ``target``; pieces that are not of the newest capture go to folders beside it."""
        groups: list[list[Path]] = []
        names: set[str] = set()
        for piece in self._pieces:
            if not piece.folder.is_dir():
                continue  # nothing was written into it
            piece_names = {image.stem for image in piece.folder.glob("*/*")}
            if groups and piece.is_continuation and not names & piece_names:
                groups[-1].append(piece.folder)
                names |= piece_names
            else:
                groups.append([piece.folder])
                names = piece_names
        self._pieces.clear()
        for place, group in enumerate(groups):
            before = len(groups) - 1 - place
            self._store.merge(
                group, target if not before else target.with_name(f"{target.name}-before{before}")
            )
