"""What SQLite's errors mean here."""

from __future__ import annotations

import sqlite3


def is_damage(error: sqlite3.Error) -> bool:
    """Whether the file is no sound database."""
    if isinstance(error, sqlite3.OperationalError | sqlite3.IntegrityError | sqlite3.ProgrammingError):
        return _code(error) in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
    return isinstance(error, sqlite3.DatabaseError)


def is_full(error: sqlite3.Error) -> bool:
    """Whether the disk did not take what was written: full, over quota, or failing."""
    return _code(error) in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)


def _code(error: sqlite3.Error) -> int:
    """Primary result code; 0 where the error is Python's own."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF
