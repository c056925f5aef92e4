"""A damaged database is moved aside, never emptied; the totals go on from the newest that can be read.

They are looked for in the bytes of the damaged file (the end of the ledger is kept as text with a checksum), in the
snapshot ``totals.json`` beside it, and in what the running program remembers.
"""

from __future__ import annotations

import mmap
import sqlite3
import time
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.errors import OutputError
from beltscape.sinks.durable import write_durably
from beltscape.sinks.historian.storage.connections import suspect
from beltscape.sinks.historian.storage.failures import is_damage
from beltscape.sinks.historian.storage.schema import open_writer
from beltscape.sinks.historian.writing.ledger import transaction
from beltscape.sinks.historian.writing.sums import SUMS_BEGIN, Sums, read_sums, sums_at

DATABASE = "history.db"
SNAPSHOT = "totals.json"
_QUICK_BYTES = 256 << 20
"""A database up to this size is checked page by page at every start; a larger one where it is read."""
_TEXT_BYTES = 4096
"""The text of the sums is shorter than a page."""


@dataclass(frozen=True, slots=True)
class Opened:
    """A sound database."""

    connection: sqlite3.Connection
    sums: Sums
    number: int
    """Of the last record that this very database knows of."""
    message: str
    """What had to be mended, in one line; empty where nothing."""


def open_sound(folder: Path, shift_ns: int) -> Opened:
    """Open the history in ``folder``; begin anew with the old totals where it is damaged or gone.

    Raises
    ------
    InputError
        When the database is a newer version's or another program's.
    OutputError
        When it cannot be moved aside.
    sqlite3.OperationalError
        When it cannot be written.
    """
    path = folder / DATABASE
    saved = read_snapshot(folder)
    try:
        connection = open_writer(path)
    except sqlite3.Error as error:
        if not is_damage(error):
            raise
        return begin_anew(folder, shift_ns, saved, str(error))
    try:
        sums = _checked(connection, path)
    except sqlite3.Error as error:
        connection.close()
        if not is_damage(error):
            raise
        return begin_anew(folder, shift_ns, saved, str(error))
    if saved is None or saved.number <= sums.number:
        return Opened(connection, sums, sums.number, "")
    with transaction(connection):
        _set_sums(connection, saved)
    message = (
        f"{path}: it ends with record {sums.number}, {SNAPSHOT} knows of {saved.number}: a copy from before, or it "
        "was deleted; the totals are the newer ones, the records between are not there"
    )
    return Opened(connection, saved, sums.number, message)


def begin_anew(folder: Path, shift_ns: int, known: Sums | None, why: str) -> Opened:
    """Move the database aside, and begin another one with the newest totals; nothing may have it open."""
    path = folder / DATABASE
    moved = _moved_aside(path)
    suspect(path).unlink(missing_ok=True)
    candidates = [sums for sums in (known, read_snapshot(folder), _salvaged(moved)) if sums is not None]
    sums = max(candidates, key=lambda each: each.number, default=Sums())
    connection = open_writer(path)
    with transaction(connection):
        _set_sums(connection, sums)
        connection.execute("UPDATE ledger SET shift_ns = ?", (shift_ns,))
    message = (
        f"{path}: it was damaged ({why}) and lies in {moved.parent} now; a new one goes on after record "
        f"{sums.number} with the totals kept, older records are in the day files"
    )
    return Opened(connection, sums, 0, message)


def read_snapshot(folder: Path) -> Sums | None:
    """The totals of ``totals.json``; None where it is absent or damaged."""
    try:
        return read_sums((folder / SNAPSHOT).read_text("utf-8"))
    except (OSError, UnicodeDecodeError):
        return None


def write_snapshot(folder: Path, sums: Sums) -> None:
    """Totals beside the database, for the day it is damaged; OSError where it cannot be written."""
    write_durably(folder / SNAPSHOT, (sums.text() + "\n").encode())


def _checked(connection: sqlite3.Connection, path: Path) -> Sums:
    """The sums of a database that is sound as far as one can see; sqlite3.DatabaseError where not."""
    number, state = connection.execute("SELECT number, state FROM ledger").fetchone() or (0, "gone")
    sums = Sums() if not state and not number else read_sums(state)
    if sums is None or sums.number != number:
        raise sqlite3.DatabaseError("the end of its ledger is not readable")
    if path.stat().st_size <= _QUICK_BYTES or suspect(path).exists():
        found = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        if found != "ok":
            raise sqlite3.DatabaseError(" ".join(found.split()))
        suspect(path).unlink(missing_ok=True)
    last = connection.execute("SELECT max(number) FROM records").fetchone()[0]
    if last is not None and last > number:
        raise sqlite3.DatabaseError(f"it holds record {last} behind the end of its ledger")
    return sums


def _set_sums(connection: sqlite3.Connection, sums: Sums) -> None:
    connection.execute(
        "UPDATE ledger SET number = ?, run = ?, end_mm = ?, state = ?",
        (sums.number, sums.run, sums.end_mm, sums.text()),
    )
    connection.execute("INSERT OR IGNORE INTO runs (run, wall_ns) VALUES (?, ?)", (sums.run, time.time_ns()))


def _moved_aside(path: Path) -> Path:
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    place = path.parent / "damaged" / stamp
    again = 1
    while place.exists():
        again += 1
        place = path.parent / "damaged" / f"{stamp}-{again}"
    try:
        place.mkdir(parents=True)
        for name in (path.name, f"{path.name}-wal", f"{path.name}-shm"):
            if (path.parent / name).exists():
                (path.parent / name).rename(place / name)
    except OSError as error:
        raise OutputError(
            f"{path}: it is damaged and cannot be moved to {place} ({error.strerror or error}); move it away by hand"
        ) from error
    return place / path.name


def _salvaged(path: Path) -> Sums | None:
    """The newest end of the ledger whose checksum holds, anywhere in the bytes of a database or its log."""
    found: list[Sums] = []
    for file in (path, path.with_name(f"{path.name}-wal")):
        try:
            with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                texts = (
                    data[place.start() : place.start() + _TEXT_BYTES] for place in SUMS_BEGIN.finditer(data)
                )
                found.extend(sums for sums in map(sums_at, texts) if sums is not None)
        except (OSError, ValueError):
            continue  # not there, or empty
    return max(found, key=lambda sums: sums.number, default=None)
