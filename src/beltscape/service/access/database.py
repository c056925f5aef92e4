"""The database users.db: users, their sessions, programs' keys, and whether the setup is over."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from beltscape.core.errors import BeltscapeError, OutputError
from beltscape.files.atomic import describe_refusal
from beltscape.files.sqlite_failures import describe_failure

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


_BUSY_S = 5.0
"""Time to wait while `beltscape users` writes; SQLite's default."""
_CHECK_S = 5.0
"""Interval at which ``trouble`` reads the file, so that damage is noticed before somebody signs in."""


class UsersUnreadableError(BeltscapeError):
    """The users' database cannot be read: nobody can sign in, everything else continues."""


class Database:
    """One connection for all threads; other processes may write at the same time.

    It is opened with the first use, and again after a failure: a file that was restored is used at once.
    """

    def __init__(self, folder: Path) -> None:
        """Use the database in ``folder``, which is created with the first use."""
        self.path = folder / FILE
        self._lock = threading.RLock()
        self._connection: sqlite3.Connection | None = None
        self._identity: tuple[int, int] | None = None
        self._trouble = ""
        self._checked_s = float("-inf")

    @property
    def trouble(self) -> str:
        """Why the users cannot be read, in one line; empty without a fault. The file is checked periodically."""
        if time.monotonic() - self._checked_s >= _CHECK_S:
            self._checked_s = time.monotonic()
            try:
                self.select("SELECT count(*) FROM users")
                self.select("SELECT count(*) FROM sessions")
            except BeltscapeError as error:
                self._trouble = str(error)
            else:
                self._trouble = ""
        return self._trouble

    def select(self, query: str, *values: object) -> list[tuple[Any, ...]]:
        """Return all rows of a query; UsersUnreadableError if the database is damaged."""
        with self._lock, self._report_damage():
            return self._connect().execute(query, values).fetchall()

    @contextmanager
    def transaction(self) -> Generator[sqlite3.Connection]:
        """Open a transaction: on disk when it ends, undone if it raises. OutputError if it cannot be written."""
        with self._lock, self._report_damage():
            connection = self._connect()
            try:
                connection.execute("BEGIN IMMEDIATE")
                try:
                    yield connection
                    connection.execute("COMMIT")
                except BaseException:
                    if connection.in_transaction:
                        connection.execute("ROLLBACK")
                    raise
            except sqlite3.OperationalError as error:
                raise OutputError(
                    f"{self.path}: not written: {describe_failure(self.path, error)}"
                ) from error

    def close(self) -> None:
        """Close the connection."""
        with self._lock:
            if self._connection is not None:
                self._connection.close()
                self._connection = None

    def _connect(self) -> sqlite3.Connection:
        """Return the connection to the file that has the name now; OutputError if it cannot be opened."""
        if self._connection is not None and self._identity == _identify(self.path):
            return self._connection
        self.close()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.touch(mode=0o600)
            self._connection = _open(self.path)
        except sqlite3.OperationalError as error:
            raise OutputError(f"{self.path}: not opened: {describe_failure(self.path, error)}") from error
        except OSError as error:
            raise OutputError(f"{self.path}: {describe_refusal(error)}") from error
        self._identity = _identify(self.path)
        return self._connection

    @contextmanager
    def _report_damage(self) -> Generator[None]:
        """Turn errors of a damaged file into UsersUnreadableError; the file is opened again with the next use."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.IntegrityError):
                raise
            self.close()
            if isinstance(error, sqlite3.OperationalError) and "no such table" not in str(error):
                raise OutputError(f"{self.path}: not read: {describe_failure(self.path, error)}") from error
            self._trouble = (
                f"{self.path}: no user database ({error}), so nobody can sign in; measuring continues; restore it "
                "from a backup, or remove it and set up again"
            )
            raise UsersUnreadableError(self._trouble) from error


def _open(path: Path) -> sqlite3.Connection:
    """Open the database and create its tables; sqlite3.DatabaseError if it is damaged."""
    connection = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None, check_same_thread=False)
    try:
        connection.executescript(
            "PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; PRAGMA foreign_keys=ON;" + _SCHEMA
        )
        result = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        if result != "ok":
            raise sqlite3.DatabaseError(" ".join(result.split()))
    except BaseException:
        connection.close()
        raise
    return connection


def _identify(path: Path) -> tuple[int, int] | None:
    """Return device and inode of the file; None without one."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino
