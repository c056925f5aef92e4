"""The database users.db: users, their sessions, programs' keys, and whether the setup is over."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from beltscape.core.errors import InputError, OutputError

FILE = "users.db"
_SCHEMA = """
CREATE TABLE IF NOT EXISTS users(
    name TEXT PRIMARY KEY, role TEXT NOT NULL CHECK(role IN ('viewer', 'operator', 'engineer')),
    password TEXT NOT NULL, created_s INTEGER NOT NULL, changed_s INTEGER NOT NULL) STRICT;
CREATE TABLE IF NOT EXISTS sessions(
    token TEXT PRIMARY KEY, name TEXT NOT NULL REFERENCES users(name) ON DELETE CASCADE,
    created_s INTEGER NOT NULL, seen_s INTEGER NOT NULL, address TEXT NOT NULL) STRICT;
CREATE TABLE IF NOT EXISTS keys(
    name TEXT PRIMARY KEY, token TEXT NOT NULL UNIQUE, created_s INTEGER NOT NULL) STRICT;
CREATE TABLE IF NOT EXISTS facts(key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
"""


class Database:
    """One connection for all threads; other processes may write at the same time."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / FILE
        self._lock = threading.RLock()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.path.touch(mode=0o600)
            self._connection = sqlite3.connect(
                self.path, timeout=5, isolation_level=None, check_same_thread=False
            )
            self._connection.executescript(
                "PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; PRAGMA foreign_keys=ON;" + _SCHEMA
            )
        except (OSError, sqlite3.OperationalError) as error:
            raise OutputError(
                f"{self.path}: cannot be opened ({error}); check the folder's rights"
            ) from error
        except sqlite3.DatabaseError as error:
            raise InputError(
                f"{self.path}: no user database ({error}); restore it from a backup, or remove it and set up again"
            ) from error

    def select(self, query: str, *values: object) -> list[tuple[Any, ...]]:
        """Return all rows of a query."""
        with self._lock:
            return self._connection.execute(query, values).fetchall()

    @contextmanager
    def transaction(self) -> Generator[sqlite3.Connection]:
        """Open a transaction: on disk when it ends, undone if it raises. OutputError if it cannot be written."""
        with self._lock:
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                try:
                    yield self._connection
                    self._connection.execute("COMMIT")
                except BaseException:
                    if self._connection.in_transaction:
                        self._connection.execute("ROLLBACK")
                    raise
            except sqlite3.OperationalError as error:
                raise OutputError(
                    f"{self.path}: cannot be written ({error}); make room on the disk"
                ) from error

    def close(self) -> None:
        """Close the connection."""
        with self._lock:
            self._connection.close()
