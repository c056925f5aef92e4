"""Causes of SQLite's errors, each with its own fix: a lock, a full disk, missing rights, damage."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from beltscape.core.system_calls import is_read_only

_RIGHTS = "correct the rights of file and folder"


def describe_failure(path: Path, error: sqlite3.Error) -> str:
    """Return why a database refuses to be read or written, and the fix, without the path in front."""
    code = _code(error)
    if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return f"another program holds {path.name}; close it there"
    if code == sqlite3.SQLITE_FULL:
        return "the disk is full; free some space"
    if code == sqlite3.SQLITE_READONLY and is_read_only(path.parent):
        return "the file system is read-only; mount it writable"
    if code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM, sqlite3.SQLITE_AUTH):
        return f"it may not be written; {_RIGHTS}"
    if code == sqlite3.SQLITE_CANTOPEN:
        return f"it cannot be opened; {_RIGHTS}"
    if code == sqlite3.SQLITE_IOERR:
        return f"the disk fails ({error}); check it"
    if is_damage(error):
        return f"it is damaged ({error})"
    return str(error)


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
