"""Recovery of a damaged database: it is moved aside, and a new one continues with the newest readable totals.

The totals are searched in the bytes of the damaged file (they are stored as text with a checksum), in the snapshot
``totals.json`` beside it, and in the memory of the running program.
"""

from __future__ import annotations

import mmap
import sqlite3
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.errors import OutputError
from beltscape.files.folders.durable import DAMAGED, move_aside, write_durably
from beltscape.files.sqlite_failures import is_damage
from beltscape.sinks.historian.storage.connections import locate_suspect_marker
from beltscape.sinks.historian.storage.schema import open_writer
from beltscape.sinks.historian.writing.catch_up import catch_up
from beltscape.sinks.historian.writing.ledger import set_sums, transaction
from beltscape.sinks.historian.writing.production import salvage_production
from beltscape.sinks.historian.writing.sums import SUMS_BEGIN, Sums, read_leading_sums, read_sums

DATABASE = "history.db"
SNAPSHOT = "totals.json"
_QUICK_BYTES = 256 << 20
"""A database up to this size is checked page by page at every start, a larger one only where it is read. Chosen."""
_TEXT_BYTES = 4096
"""The text of the sums is shorter than a page."""


@dataclass(frozen=True, slots=True)
class OpenedDatabase:
    """A sound database."""

    connection: sqlite3.Connection
    sums: Sums
    number: int
    """The database holds all records up to this number, and perhaps later ones behind those of unknown day files."""
    message: str
    """Line that describes the repair; empty without a repair."""


def open_or_recover(folder: Path, shift_ns: int) -> OpenedDatabase:
    """Open the history in ``folder``; replace a damaged or missing database by a new one with the old totals.

    Where day files or tables in csv/ reach further than the database, the ledger continues behind them.

    Raises
    ------
    InputError
        When the database is a newer version's or another program's.
    OutputError
        When it cannot be moved aside.
    sqlite3.OperationalError
        When it cannot be written.
    """
    opened = _open_or_replace(folder, shift_ns)
    try:
        caught_up = catch_up(opened.connection, opened.sums, folder, shift_ns)
    except BaseException:
        opened.connection.close()
        raise
    messages = [text for text in (opened.message, caught_up.message) if text]
    return OpenedDatabase(opened.connection, caught_up.sums, opened.number, "; ".join(messages))


def _open_or_replace(folder: Path, shift_ns: int) -> OpenedDatabase:
    path = folder / DATABASE
    saved = read_snapshot(folder)
    try:
        connection = open_writer(path)
    except sqlite3.Error as error:
        if not is_damage(error):
            raise
        return replace_database(folder, shift_ns, saved, str(error))
    try:
        sums = _check_database(connection, path)
    except sqlite3.Error as error:
        connection.close()
        if not is_damage(error):
            raise
        return replace_database(folder, shift_ns, saved, str(error))
    if saved is None or saved.number <= sums.number:
        return OpenedDatabase(connection, sums, sums.number, "")
    with transaction(connection):
        set_sums(connection, saved)
    message = (
        f"{path}: it ends with record {sums.number}, {SNAPSHOT} with {saved.number}: it is an older copy, or it "
        "was deleted; the newer totals are used, the records between are missing"
    )
    return OpenedDatabase(connection, saved, sums.number, message)


def replace_database(folder: Path, shift_ns: int, known: Sums | None, why: str) -> OpenedDatabase:
    """Move the database aside and create a new one with the newest totals; no connection may be open."""
    path = folder / DATABASE
    moved = move_database_aside(path)
    locate_suspect_marker(path).unlink(missing_ok=True)
    candidates = [sums for sums in (known, read_snapshot(folder), _salvage_sums(moved)) if sums is not None]
    sums = max(candidates, key=lambda each: each.number, default=Sums())
    connection = open_writer(path)
    with transaction(connection):
        set_sums(connection, sums)
        connection.execute("UPDATE ledger SET shift_ns = ?", (shift_ns,))
        salvage_production(moved, connection)
    message = (
        f"{path}: it was damaged ({why}) and was moved to {moved.parent}; a new one continues after record "
        f"{sums.number} with the same totals, older records are in the day files"
    )
    return OpenedDatabase(connection, sums, 0, message)


def read_snapshot(folder: Path) -> Sums | None:
    """Return the totals of ``totals.json``; None if it is absent or damaged."""
    try:
        return read_sums((folder / SNAPSHOT).read_text("utf-8"))
    except (OSError, UnicodeDecodeError):
        return None


def write_snapshot(folder: Path, sums: Sums) -> None:
    """Write the totals beside the database, for its recovery; OSError if that fails."""
    write_durably(folder / SNAPSHOT, (sums.text() + "\n").encode())


def _check_database(connection: sqlite3.Connection, path: Path) -> Sums:
    """Check the database and return its sums; sqlite3.DatabaseError if it is damaged."""
    number, state = connection.execute("SELECT number, state FROM ledger").fetchone() or (0, "gone")
    sums = Sums() if not state and not number else read_sums(state)
    if sums is None or sums.number != number:
        raise sqlite3.DatabaseError("the end of its ledger is not readable")
    if path.stat().st_size <= _QUICK_BYTES or locate_suspect_marker(path).exists():
        result = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        if result != "ok":
            raise sqlite3.DatabaseError(" ".join(result.split()))
        locate_suspect_marker(path).unlink(missing_ok=True)
    last = connection.execute("SELECT max(number) FROM records").fetchone()[0]
    if last is not None and last > number:
        raise sqlite3.DatabaseError(f"it holds record {last} behind the end of its ledger")
    return sums


def move_database_aside(path: Path) -> Path:
    """Move a database with its log to a new folder in damaged/; return its path there. OutputError if impossible."""
    try:
        return move_aside(path, ("-wal", "-shm"))
    except OSError as error:
        raise OutputError(
            f"{path}: it is damaged and cannot be moved to {path.parent / DAMAGED} ({error.strerror or error}); move "
            "it away by hand"
        ) from error


def _salvage_sums(path: Path) -> Sums | None:
    """Return the newest sums with a valid checksum anywhere in the bytes of a database or its log."""
    found: list[Sums] = []
    for file in (path, path.with_name(f"{path.name}-wal")):
        try:
            with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                texts = (
                    data[place.start() : place.start() + _TEXT_BYTES] for place in SUMS_BEGIN.finditer(data)
                )
                found.extend(sums for sums in map(read_leading_sums, texts) if sums is not None)
        except (OSError, ValueError):
            continue  # absent or empty
    return max(found, key=lambda sums: sums.number, default=None)
