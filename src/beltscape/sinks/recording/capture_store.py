"""The folder of recorded captures: their order, their sizes, their removal."""

from __future__ import annotations

import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from beltscape.files.tables.csv_table import append_rows
from beltscape.sinks.recording.capture_writer import ENCODER, ENCODER_HEADER, truncate_partial_line

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
