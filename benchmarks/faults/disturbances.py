"""What others do to the files of a running system."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

_DATABASE = "history.db"


def _empty_database(data: Path) -> Callable[[], None]:
    """Delete the rows of every table of the history."""
    with closing(sqlite3.connect(data / _DATABASE)) as connection, connection:
        tables = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        for (name,) in tables:
            if not str(name).startswith("sqlite_"):
                connection.execute(f'DELETE FROM "{name}"')
    return _leave


def _remove_database(data: Path) -> Callable[[], None]:
    """Remove the history's files."""
    for path in data.glob(f"{_DATABASE}*"):
        path.unlink()
    return _leave


def _hold_database(data: Path) -> Callable[[], None]:
    """Hold the history's lock for writing, as a browser of databases does with an edit that is not written yet."""
    connection = sqlite3.connect(data / _DATABASE, isolation_level=None, timeout=60)
    connection.execute("BEGIN IMMEDIATE")
    return connection.close


def _leave() -> None:
    """Leave it as it is."""


DISTURBANCES: Mapping[str, Callable[[Path], Callable[[], None]]] = {
    "database emptied": _empty_database,
    "database removed": _remove_database,
    "database held": _hold_database,
}
"""By name: what is done in the data folder when the fault begins; it returns what ends it with the recording."""
