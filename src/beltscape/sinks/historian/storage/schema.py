"""Opening of the database, and the migration of older versions, of which a copy is kept."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from beltscape.core.errors import InputError, OutputError
from beltscape.files.folders.durable import commit_file
from beltscape.files.sqlite_failures import is_damage
from beltscape.sinks.historian.storage.migrations import MIGRATIONS

COPIES = "before_update"
"""Folder beside a database of its copies from before a newer program changed its tables."""
BUSY_S = 10.0
"""Time to wait for another program that holds the database; a commit of a script takes less. Chosen."""
APPLICATION_ID = 0x62656C74
"""Identifies the program's files: "belt" in ASCII."""


def open_writer(path: Path) -> sqlite3.Connection:
    """Open the only writing connection and migrate the tables; sqlite3.DatabaseError if the file is damaged.

    Raises
    ------
    InputError
        When a newer version of the program wrote the file, or it is another program's.
    """
    connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=BUSY_S)
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA temp_store = MEMORY")
        connection.execute("PRAGMA cache_size = -16384")
        connection.execute("PRAGMA journal_size_limit = 16777216")
        _migrate(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


def open_reader(path: Path) -> sqlite3.Connection:
    """Open a read-only connection, which never blocks the writer."""
    connection = sqlite3.connect(
        f"{path.absolute().as_uri()}?mode=ro",
        uri=True,
        check_same_thread=False,
        isolation_level=None,
        timeout=BUSY_S,
    )
    connection.execute("PRAGMA query_only = ON")
    connection.execute("PRAGMA temp_store = MEMORY")
    return connection


def require_known(connection: sqlite3.Connection, path: Path) -> int:
    """Return the version of a history; InputError if it is too new, or another program's database."""
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if connection.execute("PRAGMA application_id").fetchone()[0] not in (0, APPLICATION_ID):
        raise InputError(f"{path}: another program's database; give beltscape a data folder of its own")
    if version > len(MIGRATIONS):
        raise InputError(
            f"{path}: its version is {version}, this program knows up to {len(MIGRATIONS)}; "
            f"install the version that wrote it{_describe_copies(path)}"
        )
    return version


def keep_copy(connection: sqlite3.Connection, path: Path, version: int) -> Path:
    """Copy a database before it is migrated, for a return to the program that wrote it; return the copy's path.

    Raises
    ------
    OutputError
        If it cannot be written; then nothing has changed.
    """
    target = path.parent / COPIES / f"{path.stem}.v{version}.db"
    part = target.with_suffix(".part")
    try:
        target.parent.mkdir(exist_ok=True)
        part.unlink(missing_ok=True)
        with closing(sqlite3.connect(part)) as copy:
            connection.backup(copy)
            copy.execute("PRAGMA journal_mode = DELETE")
        commit_file(part, target)
    except (OSError, sqlite3.Error) as error:
        part.unlink(missing_ok=True)
        if isinstance(error, sqlite3.Error) and is_damage(error):
            raise  # the history is repaired instead
        size = path.stat().st_size / 2**20
        raise OutputError(
            f"{target}: cannot be written ({error}); the update copies the history of {size:.0f} MiB first: free "
            "that much there"
        ) from error
    return target


def _describe_copies(path: Path) -> str:
    """Return how to return to this program by a copy from before the update; empty without a copy."""
    copies = [
        path.parent / COPIES / f"{path.stem}.v{version}.db" for version in range(len(MIGRATIONS), 0, -1)
    ]
    copy = next((one for one in copies if one.is_file()), None)
    return (
        "" if copy is None else f", or restore a backup of before the update ({copy} is the history of then)"
    )


def _migrate(connection: sqlite3.Connection, path: Path) -> None:
    version = require_known(connection, path)
    if 0 < version < len(MIGRATIONS):
        keep_copy(connection, path, version)
    for step in range(version, len(MIGRATIONS)):
        # a script is one transaction: a crash leaves the old version
        connection.executescript(
            f"BEGIN IMMEDIATE; {MIGRATIONS[step]}; PRAGMA application_id = {APPLICATION_ID}; "
            f"PRAGMA user_version = {step + 1}; COMMIT;"
        )
