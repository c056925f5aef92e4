"""Classification of SQLite's errors: damaged database, full disk."""

from __future__ import annotations

import sqlite3


def is_damage(error: sqlite3.Error) -> bool:
    """Return whether the error shows a damaged file or no database."""
    if isinstance(error, sqlite3.OperationalError | sqlite3.IntegrityError | sqlite3.ProgrammingError):
        return _code(error) in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
    return isinstance(error, sqlite3.DatabaseError)


def is_full(error: sqlite3.Error) -> bool:
    """Return whether the disk refused the data: full, over quota, or failing."""
    return _code(error) in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)


def _code(error: sqlite3.Error) -> int:
    """Return the primary result code; 0 for Python's own errors."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF
