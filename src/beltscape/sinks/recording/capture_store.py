"""Where captures lie, how much they take, which go first."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from beltscape.sinks.recording.capture_writer import ENCODER, append_lines, mend_lines

_PART = ".part"


class Shelf:
    """The folder of recordings: ``ring/``, ``all/`` and ``kept/``, each with captures named in order.

    A capture's name is a number that grows and the wall clock; only the number says the order.
    """

    def __init__(self, folder: Path) -> None:
        """Look at what earlier runs left; what they were moving when they ended is finished."""
        self.folder = folder
        self._sizes: dict[Path, int] = {}
        for place in ("ring", "all", "kept"):
            for capture in _captures(folder / place):
                self._sizes[capture] = _size(capture)
        for part in (folder / "kept").glob(f"*{_PART}"):
            self._sizes[_finished(part)] = _size(part.with_suffix(""))
        for capture in [*self.of("ring"), *self.of("all")[-1:]]:
            mend_lines(capture / ENCODER)
        self._next = 1 + max((_number(path) for path in self._sizes), default=0)

    @property
    def size_bytes(self) -> int:
        """All captures."""
        return sum(list(self._sizes.values()))

    @property
    def kept_bytes(self) -> int:
        """Those that somebody asked to keep."""
        return sum(size for path, size in list(self._sizes.items()) if path.parent.name == "kept")

    def of(self, place: str) -> list[Path]:
        """Captures at "ring", "all" or "kept", oldest first."""
        return sorted((p for p in list(self._sizes) if p.parent.name == place), key=_number)

    def new(self, place: str, reason: str = "") -> Path:
        """A name for the next capture; nothing is made yet."""
        words = re.sub(r"[^\w.-]+", "-", reason).strip("-.")[:40]
        stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        name = f"{self._next:06d}-{stamp}" + (f"-{words}" if words else "")
        self._next += 1
        return self.folder / place / name

    def grew(self, capture: Path, size: int) -> None:
        """That many bytes more lie in that capture."""
        self._sizes[capture] = self._sizes.get(capture, 0) + size

    def refresh(self) -> None:
        """Captures that somebody else removed take nothing any more."""
        for capture in [path for path in self._sizes if not path.is_dir()]:
            del self._sizes[capture]

    def remove(self, capture: Path) -> None:
        """Delete a capture."""
        shutil.rmtree(capture, ignore_errors=True)
        self._sizes.pop(capture, None)

    def merge(self, captures: list[Path], target: Path) -> None:
        """Move consecutive captures into one; it has its name only when it is complete."""
        part = target.with_name(target.name + _PART)
        part.mkdir(parents=True, exist_ok=True)
        for capture in captures:
            for camera in (p for p in sorted(capture.iterdir()) if p.is_dir()):
                (part / camera.name).mkdir(exist_ok=True)
                for image in camera.iterdir():
                    image.replace(part / camera.name / image.name)
            if (capture / ENCODER).exists():
                rows = (capture / ENCODER).read_bytes().split(b"\n", 1)[1]
                append_lines(part / ENCODER, rows)
            size = self._sizes.get(capture, 0)
            self.remove(capture)
            self.grew(target, size)
        part.replace(target)


def _captures(place: Path) -> Iterator[Path]:
    return (p for p in place.glob("*") if p.is_dir() and _number(p) and p.suffix != _PART)


def _finished(part: Path) -> Path:
    """What a crash interrupted: the images moved so far are a capture."""
    return part.replace(part.with_suffix(""))


def _number(capture: Path) -> int:
    found = re.match(r"\d+", capture.name)
    return int(found[0]) if found else 0


def _size(capture: Path) -> int:
    return sum(p.stat().st_size for p in capture.rglob("*") if p.is_file())
