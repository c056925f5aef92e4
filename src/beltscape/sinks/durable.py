"""Durable writing of files: their content is on the disk before they get their name."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from beltscape.core.runtime.system_calls import sync_folder


def commit_file(temporary: Path, path: Path) -> None:
    """Rename a finished file to ``path``; content and name are on the disk when this returns. OSError otherwise."""
    with temporary.open("r+b") as file:
        os.fsync(file.fileno())
    temporary.replace(path)
    sync_folder(path.parent)


def write_durably(path: Path, data: bytes) -> None:
    """Replace a file durably and atomically; OSError if it cannot be written."""
    temporary = path.with_name(f".{path.name}.part")
    try:
        temporary.write_bytes(data)
        commit_file(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
