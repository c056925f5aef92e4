"""Rescue of a database that another program deleted, replaced, cut or changed while it was open.

The open connection still reads the file that it opened, even without a name; a copy of it takes the name again.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing, suppress
from pathlib import Path

from beltscape.core.errors import OutputError
from beltscape.files.folders.durable import commit_file, describe_refusal
from beltscape.files.sqlite_failures import describe_failure, is_temporary
from beltscape.sinks.historian.storage.schema import open_writer
from beltscape.sinks.historian.writing.ledger import set_sums, transaction
from beltscape.sinks.historian.writing.recovery import (
    DATABASE,
    OpenedDatabase,
    move_database_aside,
    replace_database,
)
from beltscape.sinks.historian.writing.sums import Sums


def rescue_database(
    folder: Path, shift_ns: int, connection: sqlite3.Connection, sums: Sums, why: str
) -> OpenedDatabase:
    """Write the database again from the open connection, which is closed; from the totals alone if it is unsound.

    Raises
    ------
    OutputError
        When the folder cannot be written.
    """
    path = folder / DATABASE
    copy = folder / f".{DATABASE}.rescued"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        copy.unlink(missing_ok=True)
        correct_end(connection, sums)
        with closing(sqlite3.connect(copy)) as target:
            connection.backup(target)
            _require_sound(target)
            target.execute("PRAGMA journal_mode = DELETE")
    except (sqlite3.Error, OSError) as error:
        with suppress(OSError):
            copy.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise _output_error(path, why, describe_refusal(error)) from error
        if is_temporary(error):
            raise _output_error(path, why, describe_failure(path, error)) from error
        connection.close()
        return replace_database(folder, shift_ns, sums, why)
    try:
        connection.close()
        moved = move_database_aside(path)
        commit_file(copy, path)
    except OSError as error:
        raise _output_error(path, why, describe_refusal(error)) from error
    message = f"{path}: {why}; it was written again with all records and totals"
    if moved.exists():
        message += f", what was found there is in {moved.parent}"
    return OpenedDatabase(open_writer(path), sums, sums.number, message)


def correct_end(connection: sqlite3.Connection, sums: Sums) -> bool:
    """Set the stored end of the ledger to ``sums`` if it differs; return whether it did.

    Raises
    ------
    sqlite3.Error
        When the tables are not those of a history.
    """
    stored = connection.execute("SELECT number, end_mm, state FROM ledger").fetchone()
    connection.execute("SELECT max(number) FROM records").fetchone()
    expected = (sums.number, sums.end_mm, sums.text())
    if stored == expected or (stored is not None and not sums.number and stored == (0, None, "")):
        return False
    with transaction(connection):
        connection.execute("INSERT OR IGNORE INTO ledger VALUES (1, 0, 0, NULL, NULL, '')")
        set_sums(connection, sums)
    return True


def _output_error(path: Path, why: str, reason: str) -> OutputError:
    return OutputError(f"{path}: {why}; it is not written again yet: {reason}")


def _require_sound(connection: sqlite3.Connection) -> None:
    result = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if result != "ok":
        raise sqlite3.DatabaseError(" ".join(result.split()))
