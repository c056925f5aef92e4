"""Days that are over become files; files that turn up are taken in."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from dataclasses import astuple, fields
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.core.errors import InputError
from beltscape.sinks.days import day_name, day_of, day_range_ns
from beltscape.sinks.historian.reading.records import database_rows
from beltscape.sinks.historian.storage.day_files import DayFile, read_about, read_day, write_day
from beltscape.sinks.historian.storage.day_table import to_table
from beltscape.sinks.historian.writing.buckets import add_to_buckets
from beltscape.sinks.historian.writing.ledger import transaction
from beltscape.sinks.historian.writing.store import Store

if TYPE_CHECKING:
    import pyarrow as pa

_ROWS = 2_000
"""Records in a row group of a day file."""
_ALL = 1 << 62
_FILE = ", ".join(field.name for field in fields(DayFile))
_UNFILED = """
    SELECT passed.day FROM (SELECT bucket / 24 AS day, max(last) AS last FROM hours GROUP BY bucket / 24) AS passed
    WHERE passed.last > (SELECT coalesce(max(files.last), 0) FROM files WHERE files.day = passed.day)
        AND passed.last >= (SELECT min(number) FROM records)
    ORDER BY passed.last"""


class Archive:
    """The folder of day files, and the table that knows them.

    A record belongs to the day that the system clock said when it was finished, and lies in exactly one file: that
    day's first one holds the day's records up to some number, a later one (where the clock came back to a day that
    had been closed) those after it.
    """

    def __init__(self, folder: Path, store: Store) -> None:
        """Nothing is done yet."""
        self.folder, self._store = folder, store
        self._adopted = -1

    def close_days(self, wall_ns: int | None) -> None:
        """Every day but that of ``wall_ns`` and that of the newest record; with None all that there is."""
        shift_ns = self._store.shift_ns
        with self._store.readers.reading() as connection:
            days = [row[0] for row in connection.execute(_UNFILED)]
            newest = connection.execute("SELECT wall_ns FROM records ORDER BY number DESC LIMIT 1").fetchone()
        going_on = (
            set()
            if wall_ns is None
            else {day_of(wall_ns, shift_ns), *(day_of(ns, shift_ns) for ns in newest or ())}
        )
        for day in days:
            if day not in going_on:
                self._close_day(day)

    def adopt(self) -> None:
        """Enter files that lie there and are not known: after a restored backup, a damaged database, a crash."""
        age = self._store.age
        if self._adopted == age:
            return
        with self._store.readers.reading() as connection:
            known = {row[0] for row in connection.execute("SELECT name FROM files")}
        for path in self.folder.glob(".*.part"):
            path.unlink(missing_ok=True)  # being written when a run ended
        for path in sorted(self.folder.glob("*.parquet")):
            if path.name not in known:
                try:
                    self._enter(read_about(path), self._store.known)
                except (InputError, FileNotFoundError):
                    continue  # somebody else's, or damaged: not ours to count
        self._adopted = age

    def sum_up(self) -> None:
        """Count one adopted file in the sums by minute and hour."""
        with self._store.readers.reading() as connection:
            files = connection.execute(
                "SELECT name, summed, last FROM files WHERE summed < last ORDER BY last LIMIT 1"
            ).fetchall()
        for name, summed, last in files:
            records = read_day(self.folder / name, (summed + 1, last), (-_ALL, _ALL), _ALL, sections=False)

            def work(connection: sqlite3.Connection, name: str = name, records: Any = records) -> None:
                with transaction(connection):
                    add_to_buckets(connection, records, self._store.shift_ns)
                    connection.execute("UPDATE files SET summed = last WHERE name = ?", (name,))

            self._store.change(work)

    def _close_day(self, day: int) -> None:
        """Write what the database holds of that day and no file does."""
        with self._store.readers.reading() as connection:
            (filed,) = connection.execute(
                "SELECT coalesce(max(last), 0) FROM files WHERE day = ?", (day,)
            ).fetchone()
        tables = self._tables(day, filed + 1)
        first = next(tables, None)
        if first is None:
            return
        name, again = day_name(day), 1
        path = self.folder / f"{name}.parquet"
        while path.exists():
            again += 1
            path = self.folder / f"{name}-{again}.parquet"
        # what the files know of, the totals beside the database know of too
        self._store.save_totals()
        made = write_day(path, day, chain([first], tables))
        self._enter(made, made.last)

    def _tables(self, day: int, number: int) -> Iterator[pa.Table]:
        """Records of a day from that number on, some thousands at a time."""
        times = day_range_ns(day, self._store.shift_ns)
        while True:
            with self._store.readers.reading() as connection:
                rows, sections = database_rows(connection, (number, _ALL), times, _ROWS)
            if not rows:
                return
            yield to_table(rows, sections)
            number = rows[-1][0] + 1

    def _enter(self, file: DayFile, known: int) -> None:
        """Take a file in, where the database has records, and their sums, up to the number ``known``."""
        row = (*astuple(file), min(file.last, known), int(file.last > known))
        marks = ", ".join("?" * len(row))
        statement = f"INSERT OR REPLACE INTO files ({_FILE}, summed, pruned) VALUES ({marks})"
        self._store.change(lambda connection: connection.execute(statement, row))


def files_where(connection: sqlite3.Connection, which: str) -> list[tuple[DayFile, bool]]:
    """Known files, oldest first, and whether their records are (being) taken out of the database."""
    rows = connection.execute(f"SELECT {_FILE}, pruned FROM files WHERE {which} ORDER BY last")
    return [(DayFile(*row[:-1]), bool(row[-1])) for row in rows]
