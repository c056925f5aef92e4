"""What others do to the files of a running system."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

_DATABASE = "history.db"


def _empty_database(data: Path) -> None:
    """Delete the rows of every table of the history."""
    with closing(sqlite3.connect(data / _DATABASE)) as connection, connection:
        tables = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        for (name,) in tables:
            if not str(name).startswith("sqlite_"):
                connection.execute(f'DELETE FROM "{name}"')


def _remove_database(data: Path) -> None:
    """Remove the history's files."""
    for path in data.glob(f"{_DATABASE}*"):
        path.unlink()


DISTURBANCES: Mapping[str, Callable[[Path], None]] = {
    "database emptied": _empty_database,
    "database removed": _remove_database,
}
"""By name: what is done in the data folder when the fault begins."""
