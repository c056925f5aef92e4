"""Classification of SQLite's errors: damaged database, full disk."""

from __future__ import annotations

import sqlite3


def is_damage(error: sqlite3.Error) -> bool:
    """Return whether the error shows a damaged file, or none of a history."""
    if isinstance(error, sqlite3.OperationalError | sqlite3.IntegrityError | sqlite3.ProgrammingError):
        is_bare = str(error).startswith("no such table")  # another program's work
        return is_bare or _code(error) in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
    return isinstance(error, sqlite3.DatabaseError)


def is_full(error: sqlite3.Error) -> bool:
    """Return whether the disk refused the data: full, over quota, or failing."""
    return _code(error) in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)


def is_temporary(error: sqlite3.Error) -> bool:
    """Return whether another program only blocks the database, or memory is short."""
    return is_full(error) or _code(error) in (
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_NOMEM,
        sqlite3.SQLITE_CANTOPEN,
    )


def _code(error: sqlite3.Error) -> int:
    """Return the primary result code; 0 for Python's own errors."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF
