"""Retention: removal of old records from the database and of old day files; totals and the ledger's end remain.

Age is counted in days with records, not by the clock: a clock that jumps removes nothing.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

from beltscape.core.errors import BeltscapeError, OutputError
from beltscape.files.documents.digest import hash_file
from beltscape.files.folders.durable import move_aside
from beltscape.sinks.days import compute_day_range_ns
from beltscape.sinks.historian.archive.closed_days import Archive, select_files
from beltscape.sinks.historian.storage.day_files import DayFile
from beltscape.sinks.historian.writing.ledger import transaction
from beltscape.sinks.historian.writing.production import forget_production
from beltscape.sinks.historian.writing.store import REMOVED_AT_ONCE, Store
from beltscape.sinks.settings import GIB, HistorySettings

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
