"""The archive of findings: closed days as Parquet files, and their retention.

Age is counted in days with findings, not by the clock: a clock that jumps removes nothing.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

from beltscape.core.errors import InputError
from beltscape.sinks.days import DAY_NS, compute_day, compute_day_range_ns, format_day
from beltscape.sinks.historian.findings import TEN_MINUTES_NS, read_finding_day, write_finding_day
from beltscape.sinks.historian.store import REMOVED_AT_ONCE, Store
from beltscape.sinks.settings import GIB, HistorySettings


class FindingArchive:
    """The folder of the findings' day files, and the table that registers them."""

    def __init__(self, folder: Path, store: Store, settings: HistorySettings) -> None:
        """Create the archive; nothing is read or written yet."""
        self.folder, self._store, self._settings = folder, store, settings
        self._adopted = -1

    def set_settings(self, settings: HistorySettings) -> None:
        """Keep by other settings from the next call on."""
        self._settings = settings

    def maintain(self, wall_ns: int) -> None:
        """Adopt unknown files, close past days, remove old findings and files."""
        self._adopt()
        self._close_days(wall_ns)
        self._prune_database()
        self._prune_files()

    def _adopt(self) -> None:
        """Register unknown files of the folder: after a restored backup or a damaged database."""
        age = self._store.age
        if self._adopted == age:
            return
        known = {row[0] for row in self._select("SELECT name FROM finding_files")}
        for path in sorted(self.folder.glob("*.parquet")):
            if path.name not in known:
                try:
                    self._register(path, read_finding_day(path), 0, pruned=True)
                except InputError:
                    continue  # another program's or damaged
        self._adopted = age

    def _close_days(self, wall_ns: int) -> None:
        """Write every day except that of ``wall_ns`` and of the newest finding."""
        shift_ns = self._store.shift_ns
        newest = self._select("SELECT wall_ns FROM findings ORDER BY finding DESC LIMIT 1")
        open_days = {compute_day(ns, shift_ns) for ns in (wall_ns, *(row[0] for row in newest))}
        buckets = self._select("SELECT DISTINCT bucket FROM finding_sums")
        days = {compute_day(row[0] * TEN_MINUTES_NS, shift_ns) for row in buckets}
        for day in sorted(days - open_days):
            self._close_day(day)

    def _close_day(self, day: int) -> None:
        """Write the day's findings that are in no file."""
        ((filed,),) = self._select("SELECT coalesce(max(last), 0) FROM finding_files WHERE day = ?", day)
        times = compute_day_range_ns(day, self._store.shift_ns)
        where = "wall_ns >= ? AND wall_ns < ? AND finding > ?"
        numbers = self._select(
            f"SELECT series, max(finding) FROM checks JOIN findings USING (series) WHERE {where} GROUP BY series "
            "ORDER BY name, subject",
            *times,
            filed,
        )
        if not numbers:
            return
        name, again = format_day(day), 1
        path = self.folder / f"{name}.parquet"
        while path.exists():
            again += 1
            path = self.folder / f"{name}-{again}.parquet"
        columns = "name, subject, unit, wall_ns, value, sigma, bound, effect, text"
        query = f"SELECT {columns} FROM checks JOIN findings USING (series) WHERE series = ? AND {where}"
        tables = (self._select(query, series, *times, filed) for series, _ in numbers)
        write_finding_day(path, day, tables)
        self._register(path, day, max(last for _, last in numbers), pruned=False)

    def _prune_database(self) -> None:
        """Remove the findings of old files from the database, in small steps between which writing continues."""
        files = self._select("SELECT name, day, last FROM finding_files WHERE last > 0 ORDER BY last DESC")
        kept = self._settings.database_days
        if self._store.used_bytes() > self._settings.database_gib * GIB:
            kept = 1
        days = list(dict.fromkeys(day for _, day, _ in files))[: kept - 1]
        for name, day, last in files:
            if day not in days:
                self._delete(day, last)
                self._store.transact(
                    lambda c, name=name: c.execute(
                        "UPDATE finding_files SET pruned = 1 WHERE name = ?", (name,)
                    )
                )

    def _delete(self, day: int, last: int) -> None:
        times = compute_day_range_ns(day, self._store.shift_ns)
        while True:
            numbers = self._select(
                "SELECT finding FROM checks JOIN findings USING (series) "
                "WHERE wall_ns >= ? AND wall_ns < ? AND finding <= ? LIMIT ?",
                *times,
                last,
                REMOVED_AT_ONCE,
            )
            if not numbers:
                return
            self._store.transact(
                lambda c, numbers=numbers: c.executemany("DELETE FROM findings WHERE finding = ?", numbers)
            )

    def _prune_files(self) -> None:
        """Remove day files by age and by size, the oldest first, with their sums."""
        files = self._select("SELECT name, day, bytes FROM finding_files WHERE pruned ORDER BY day")
        days = sorted({day for _, day, _ in files})[-self._settings.file_days :]
        total = sum(size for _, _, size in files)
        for name, day, size in files:
            if day in days and total <= self._settings.file_gib * GIB:
                return
            (self.folder / name).unlink(missing_ok=True)
            end = ((day + 1) * DAY_NS + self._store.shift_ns) // TEN_MINUTES_NS

            def forget(connection: sqlite3.Connection, name: str = name, end: int = end) -> None:
                connection.execute("DELETE FROM finding_sums WHERE bucket < ?", (end,))
                connection.execute("DELETE FROM finding_files WHERE name = ?", (name,))

            self._store.transact(forget)
            total -= size

    def _register(self, path: Path, day: int, last: int, *, pruned: bool) -> None:
        row = (path.name, day, last, path.stat().st_size, int(pruned))
        statement = "INSERT OR REPLACE INTO finding_files VALUES (?, ?, ?, ?, ?)"
        self._store.transact(lambda connection: connection.execute(statement, row))

    def _select(self, query: str, *values: int) -> list[tuple[Any, ...]]:
        with self._store.readers.borrow() as connection:
            return connection.execute(query, values).fetchall()
