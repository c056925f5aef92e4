"""The pool of read-only connections, one for each concurrent reader."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.files.sqlite_failures import describe_failure, is_damage
from beltscape.sinks.historian.storage.schema import open_reader

_IDLE = 8
"""Number of idle connections that are kept open: as many readers as a busy page has."""


def locate_suspect_marker(path: Path) -> Path:
    """Return the marker file that makes the next start check the whole database."""
    return path.with_name(f"{path.stem}.suspect")


class ReaderPool:
    """Lends connections to threads; no connection is used by two at once."""

    def __init__(self, path: Path) -> None:
        """Create the pool of the database at ``path``, which must exist when a connection is borrowed."""
        self._path = path
        self._lock = threading.Lock()
        self._idle: list[sqlite3.Connection] = []
        self._age = 0
        self._closed = False

    @contextmanager
    def borrow(self) -> Generator[sqlite3.Connection]:
        """Lend a connection with one consistent view of the data until the block ends.

        Raises
        ------
        InputError
            When the database cannot be read, or is closed.
        """
        with self._lock:
            if self._closed:
                raise InputError(f"{self._path}: the historian is closed")
            age, connection = self._age, self._idle.pop() if self._idle else None
        try:
            connection = open_reader(self._path) if connection is None else connection
            connection.execute("BEGIN")
            yield connection
            connection.execute("COMMIT")
        except sqlite3.Error as error:
            if is_damage(error):
                locate_suspect_marker(self._path).touch()
            raise InputError(f"{self._path}: not read: {describe_failure(self._path, error)}") from error
        finally:
            self._take_back(connection, age)

    def _take_back(self, connection: sqlite3.Connection | None, age: int) -> None:
        if connection is None:
            return
        with self._lock:
            if (
                not connection.in_transaction
                and age == self._age
                and len(self._idle) < _IDLE
                and not self._closed
            ):
                self._idle.append(connection)
                return
        connection.close()

    def reset(self) -> None:
        """Close the idle connections because the file was replaced."""
        with self._lock:
            self._age += 1
            idle, self._idle = self._idle, []
        for connection in idle:
            connection.close()

    def close(self) -> None:
        """Refuse new readers; present ones finish."""
        with self._lock:
            self._closed = True
        self.reset()
