"""Files that survive a power cut: on the disk before they get their name."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def settle(temporary: Path, path: Path) -> None:
    """Give a finished file its name; content and name are on the disk when this returns. OSError where not."""
    with temporary.open("rb") as file:
        os.fsync(file.fileno())
    temporary.replace(path)
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def write_durably(path: Path, data: bytes) -> None:
    """A whole file or the one before; OSError where it cannot be written."""
    temporary = path.with_name(f".{path.name}.part")
    try:
        temporary.write_bytes(data)
        settle(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
