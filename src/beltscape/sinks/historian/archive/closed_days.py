"""The archive of closed days: writing their files, and registering files that are found in the folder."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from dataclasses import astuple, fields
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.core.errors import InputError
from beltscape.sinks.days import compute_day, compute_day_range_ns, format_day
from beltscape.sinks.historian.reading.records import read_database_rows
from beltscape.sinks.historian.storage.day_files import UNBOUNDED, DayFile, read_day, read_summary, write_day
from beltscape.sinks.historian.storage.day_table import to_table
from beltscape.sinks.historian.writing.buckets import add_to_buckets
from beltscape.sinks.historian.writing.ledger import transaction
from beltscape.sinks.historian.writing.store import Store

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
