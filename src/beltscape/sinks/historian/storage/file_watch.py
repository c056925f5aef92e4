"""Detection of changes to the open database by other programs: deleted, replaced, cut, overwritten, written to."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing
from pathlib import Path

from beltscape.sinks.historian.storage.schema import open_reader


class FileWatch:
    """Remembers the state of a database after each own change, and compares it before the next."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        """``connection`` is the only writer of this process."""
        self._path, self._connection = path, connection
        self.remember()

    def remember(self) -> None:
        """Take the present state for the program's own; call it after each own change."""
        self._stat = _stat(self._path)
        self._version = self._data_version()

    def find_replacement(self) -> str:
        """Return how the file was replaced; empty if it is still the one that is open."""
        before, now = self._stat, _stat(self._path)
        if now is None:
            return "it was deleted while the program ran"
        if before is None or (now.st_dev, now.st_ino) != (before.st_dev, before.st_ino):
            return "it was replaced by another file while the program ran"
        if now.st_size < before.st_size:
            return f"it was cut from {before.st_size} to {now.st_size} bytes while the program ran"
        if now.st_mtime_ns != before.st_mtime_ns and (fault := self._find_damage()):
            return f"it was overwritten while the program ran ({fault})"
        self._stat = now
        return ""

    def is_written_by_others(self) -> bool:
        """Return whether another connection has committed a change; sqlite3.Error if the file cannot be read."""
        return self._data_version() != self._version

    def _data_version(self) -> int:
        return int(self._connection.execute("PRAGMA data_version").fetchone()[0])

    def _find_damage(self) -> str:
        """Return the first fault of the file on disk, which the writer's own page cache may hide."""
        try:
            with closing(open_reader(self._path)) as reader:
                result = str(reader.execute("PRAGMA quick_check(1)").fetchone()[0])
        except sqlite3.Error as error:
            return str(error)
        return "" if result == "ok" else " ".join(result.split())


def _stat(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except FileNotFoundError:
        return None
