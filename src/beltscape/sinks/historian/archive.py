"""The archive of closed days, and retention: removal of old records from the database, and of old day files.

Files of days are written, and those that are found in the folder are registered. Totals and the ledger's end remain.
Age is counted in days with records, not by the clock: a clock that jumps removes nothing.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import astuple, fields
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.core.errors import BeltscapeError, InputError, OutputError
from beltscape.files.atomic import move_aside
from beltscape.files.json_text import hash_file
from beltscape.sinks.days import compute_day, compute_day_range_ns, format_day
from beltscape.sinks.historian.day_files import (
    UNBOUNDED,
    DayFile,
    read_day,
    read_summary,
    to_table,
    write_day,
)
from beltscape.sinks.historian.ledger import add_to_buckets, transaction
from beltscape.sinks.historian.production import forget_production
from beltscape.sinks.historian.records import read_database_rows
from beltscape.sinks.historian.store import REMOVED_AT_ONCE, Store
from beltscape.sinks.settings import GIB, HistorySettings

if TYPE_CHECKING:
    import pyarrow as pa


_ROWS = 2_000
"""Records in a row group of a day file: a quarter of a megabyte with cross-sections, read as one. Chosen."""
_FILE = ", ".join(field.name for field in fields(DayFile))
_UNFILED = """
    SELECT passed.day FROM (SELECT bucket / 24 AS day, max(last) AS last FROM hours GROUP BY bucket / 24) AS passed
    WHERE passed.last > (SELECT coalesce(max(files.last), 0) FROM files WHERE files.day = passed.day)
        AND passed.last >= (SELECT min(number) FROM records)
    ORDER BY passed.last"""


class Archive:
    """The folder of day files, and the table that registers them.

    A record belongs to the system clock's day when it was finished, and is in exactly one file: the first file of a
    day holds its records up to some number, a later one (if the clock returned to a closed day) those after it.
    """

    def __init__(self, folder: Path, store: Store) -> None:
        """Create the archive; nothing is read or written yet."""
        self.folder, self._store = folder, store
        self._adopted = -1

    def close_days(self, wall_ns: int | None) -> None:
        """Close every day except those of ``wall_ns`` and of the newest record; with None close all days."""
        shift_ns = self._store.shift_ns
        with self._store.readers.borrow() as connection:
            days = [row[0] for row in connection.execute(_UNFILED)]
            newest = connection.execute("SELECT wall_ns FROM records ORDER BY number DESC LIMIT 1").fetchone()
        open_days: set[int] = (
            set()
            if wall_ns is None
            else {compute_day(wall_ns, shift_ns), *(compute_day(ns, shift_ns) for ns in newest or ())}
        )
        for day in days:
            if day not in open_days:
                self._close_day(day)

    def adopt(self) -> None:
        """Register unknown files of the folder: after a restored backup, a damaged database, a crash."""
        age = self._store.age
        if self._adopted == age:
            return
        with self._store.readers.borrow() as connection:
            registered = {row[0] for row in connection.execute("SELECT name FROM files")}
        for path in self.folder.glob(".*.part"):
            path.unlink(missing_ok=True)  # incomplete since an interrupted run
        for path in sorted(self.folder.glob("*.parquet")):
            if path.name not in registered:
                try:
                    self._register(read_summary(path), self._store.last_number)
                except (InputError, FileNotFoundError):
                    continue  # another program's or damaged
        self._adopted = age

    def add_to_sums(self) -> None:
        """Add one adopted file to the sums by minute and hour."""
        with self._store.readers.borrow() as connection:
            files = connection.execute(
                "SELECT name, summed, last FROM files WHERE summed < last ORDER BY last LIMIT 1"
            ).fetchall()
        for name, summed, last in files:
            records = read_day(self.folder / name, (summed + 1, last), sections=False)

            def work(connection: sqlite3.Connection, name: str = name, records: Any = records) -> None:
                with transaction(connection):
                    add_to_buckets(connection, records, self._store.shift_ns)
                    connection.execute("UPDATE files SET summed = last WHERE name = ?", (name,))

            self._store.transact(work)

    def _close_day(self, day: int) -> None:
        """Write the day's records that are in the database and in no file."""
        with self._store.readers.borrow() as connection:
            (filed,) = connection.execute(
                "SELECT coalesce(max(last), 0) FROM files WHERE day = ?", (day,)
            ).fetchone()
        tables = self._tables(day, filed + 1)
        first = next(tables, None)
        if first is None:
            return
        name, again = format_day(day), 1
        path = self.folder / f"{name}.parquet"
        while path.exists():
            again += 1
            path = self.folder / f"{name}-{again}.parquet"
        # the totals beside the database must include all records of the files
        self._store.save_totals()
        made = write_day(path, day, chain([first], tables))
        self._register(made, made.last)

    def _tables(self, day: int, number: int) -> Iterator[pa.Table]:
        """Yield the records of a day from a number on, some thousands at a time."""
        times = compute_day_range_ns(day, self._store.shift_ns)
        while True:
            with self._store.readers.borrow() as connection:
                rows, sections = read_database_rows(connection, (number, UNBOUNDED), times, _ROWS)
            if not rows:
                return
            yield to_table(rows, sections)
            number = rows[-1][0] + 1

    def _register(self, file: DayFile, known: int) -> None:
        """Register a file; the database has records and their sums up to the number ``known``."""
        row = (*astuple(file), min(file.last, known), int(file.last > known))
        marks = ", ".join("?" * len(row))
        statement = f"INSERT OR REPLACE INTO files ({_FILE}, summed, pruned) VALUES ({marks})"
        self._store.transact(lambda connection: connection.execute(statement, row))


def select_files(connection: sqlite3.Connection, which: str) -> list[tuple[DayFile, bool]]:
    """Return the registered files, oldest first, and whether their records are (being) removed from the database."""
    rows = connection.execute(f"SELECT {_FILE}, pruned FROM files WHERE {which} ORDER BY last")
    return [(DayFile(*row[:-1]), bool(row[-1])) for row in rows]


_KEPT_SHARE = 0.9
"""Share of the limit to which a full database is reduced, so that it is not reduced at every check. Chosen."""


class Retention:
    """Keeps the history within its limits, in small steps beside the writing."""

    def __init__(
        self,
        folder: Path,
        store: Store,
        settings: HistorySettings,
        others: Sequence[Callable[[int], None]] = (),
    ) -> None:
        """``folder`` has the day files; ``others`` are further steps of the housekeeping, given the clock."""
        self._store, self._settings = store, settings
        self._archive, self._others = Archive(folder, store), others
        self._lock = threading.Lock()
        with suppress(OutputError):  # ``maintain`` tries again
            self._archive.adopt()

    def set_settings(self, settings: HistorySettings) -> None:
        """Keep by other settings from the next call on."""
        self._settings = settings

    def maintain(self, wall_ns: int) -> str:
        """Close days, adopt files, remove old data; return the failures in one line, empty without any.

        Fast if there is nothing to do; closing a day of half a million records takes seconds.
        """
        failures: list[str] = []
        archive = self._archive
        with self._lock:
            for step in (
                *(partial(other, wall_ns) for other in self._others),
                archive.adopt,
                lambda: archive.close_days(wall_ns),
                archive.add_to_sums,
                self._prune_by_age,
                self._prune_by_size,
                self._prune_files,
                self._prune_events,
            ):
                try:
                    step()
                except (BeltscapeError, OSError) as error:
                    failures.append(str(error))
        return "; ".join(failures)

    def _prune_by_age(self) -> None:
        with self._store.readers.borrow() as connection:
            files = select_files(connection, "NOT pruned OR last >= (SELECT min(number) FROM records)")
            days = _newest_days(connection, self._settings.database_days)
        for file, pruned in files:
            if pruned:
                self._delete_records(file)  # a crash interrupted the removal
            elif file.day not in days:
                self._remove_from_database(file)

    def _prune_by_size(self) -> None:
        limit = self._settings.database_gib * GIB
        if self._store.used_bytes() <= limit:
            return
        # days without a file are closed early
        self._archive.close_days(None)
        with self._store.readers.borrow() as connection:
            files = select_files(connection, "NOT pruned")
        for file, _ in files:
            if self._store.used_bytes() <= _KEPT_SHARE * limit:
                return
            self._remove_from_database(file)

    def _remove_from_database(self, file: DayFile) -> None:
        """Remove the records of a file from the database if the file is unchanged since it was written."""
        path = self._archive.folder / file.name
        try:
            is_unchanged = not file.sha256 or hash_file(path) == file.sha256
        except OSError:
            is_unchanged = False
        if is_unchanged:
            self._store.transact(
                lambda c: c.execute("UPDATE files SET pruned = 1 WHERE name = ?", (file.name,))
            )
            self._delete_records(file)
            return
        if path.exists():
            move_aside(path)
        self._store.transact(lambda c: c.execute("DELETE FROM files WHERE name = ?", (file.name,)))
        raise OutputError(
            f"{path}: it was damaged or removed too early; it is written again from the database"
        )

    def _delete_records(self, file: DayFile) -> None:
        """Delete the records of a file in small steps, between which writing continues."""
        times = compute_day_range_ns(file.day, self._store.shift_ns)
        while True:
            with self._store.readers.borrow() as connection:
                numbers = connection.execute(
                    "SELECT number FROM records "
                    "WHERE number BETWEEN ? AND ? AND wall_ns >= ? AND wall_ns < ? LIMIT ?",
                    (file.first, file.last, *times, REMOVED_AT_ONCE),
                ).fetchall()
            if not numbers:
                return
            self._store.transact(lambda c, numbers=numbers: _delete(c, numbers))

    def _prune_files(self) -> None:
        """Remove day files by age and by size, the oldest first, with their sums by the minute."""
        with self._store.readers.borrow() as connection:
            files = select_files(connection, "pruned")
            days = _newest_days(connection, self._settings.file_days)
            (total,) = connection.execute("SELECT total(bytes) FROM files").fetchone()
        for file, _ in files:
            if file.day in days and total <= self._settings.file_gib * GIB:
                return
            (self._archive.folder / file.name).unlink(missing_ok=True)
            self._store.transact(lambda c, file=file: _forget_file(c, file))
            total -= file.bytes

    def _prune_events(self) -> None:
        oldest = "SELECT max(event) - ? FROM events"
        self._store.transact(
            lambda c: c.execute(f"DELETE FROM events WHERE event <= ({oldest})", (self._settings.events,))
        )


def _newest_days(connection: sqlite3.Connection, count: int) -> set[int]:
    """Return the last days with records, in order of record numbers and not of the clock."""
    rows = connection.execute(
        "SELECT bucket / 24 AS day FROM hours GROUP BY day ORDER BY max(last) DESC LIMIT ?", (count,)
    )
    return {row[0] for row in rows}


def _delete(connection: sqlite3.Connection, numbers: list[tuple[int]]) -> None:
    with transaction(connection):
        connection.executemany("DELETE FROM sections WHERE number = ?", numbers)
        connection.executemany("DELETE FROM records WHERE number = ?", numbers)


def _forget_file(connection: sqlite3.Connection, file: DayFile) -> None:
    with transaction(connection):
        connection.execute("DELETE FROM files WHERE name = ?", (file.name,))
        connection.execute("DELETE FROM minutes WHERE last <= ?", (file.last,))
        forget_production(connection, file.until_ns)
