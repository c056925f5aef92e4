"""Read-only connections, one to whoever reads just now."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.sinks.historian.storage.failures import is_damage
from beltscape.sinks.historian.storage.schema import open_reader

_IDLE = 8
"""Connections that are kept open for the next reader."""


def suspect(path: Path) -> Path:
    """The file that asks the next start to look at all of the database."""
    return path.with_name(f"{path.stem}.suspect")


class Readers:
    """Lends connections to threads; none is ever used by two at once."""

    def __init__(self, path: Path) -> None:
        """Of the database at ``path``; it must be there when somebody reads."""
        self._path = path
        self._lock = threading.Lock()
        self._idle: list[sqlite3.Connection] = []
        self._age = 0
        self._closed = False

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """A connection with one view of the data until the block ends.

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
                suspect(self._path).touch()
            raise InputError(f"{self._path}: cannot be read ({error})") from error
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

    def renew(self) -> None:
        """The file is another one now."""
        with self._lock:
            self._age += 1
            idle, self._idle = self._idle, []
        for connection in idle:
            connection.close()

    def close(self) -> None:
        """Nobody reads any more; who still does finishes."""
        with self._lock:
            self._closed = True
        self.renew()
