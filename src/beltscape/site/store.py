"""The sums of all belts on the disk, with the number of the last record that each of them counts.

A batch of records and the cursor behind it are written in one transaction, so that a kill at any moment neither loses
nor doubles a record. After a loss of power the newest transactions may be gone, sums and cursors together; their
records are fetched again.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import RLock
from typing import Any

from beltscape.core.errors import OutputError
from beltscape.files.sqlite_failures import describe_failure, is_damage
from beltscape.site.balance import BalanceResult
from beltscape.site.catch_up import FIELDS, Cursor, Gap, PieceSums, RecordSums

FILE = "site.db"
_VERSION = 1
"""Version of the tables."""
_COLUMNS = ", ".join(FIELDS)
_TABLES = f"""
CREATE TABLE IF NOT EXISTS belts (
    belt TEXT PRIMARY KEY, number INTEGER NOT NULL, run INTEGER NOT NULL, wall_ms INTEGER NOT NULL,
    mark TEXT NOT NULL, complete_ms INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE TABLE IF NOT EXISTS seconds (
    belt TEXT NOT NULL, second INTEGER NOT NULL, {" REAL NOT NULL, ".join(FIELDS)} REAL NOT NULL,
    PRIMARY KEY (belt, second)
) WITHOUT ROWID, STRICT;
CREATE TABLE IF NOT EXISTS quarters (
    belt TEXT NOT NULL, second INTEGER NOT NULL, {" REAL NOT NULL, ".join(FIELDS)} REAL NOT NULL,
    PRIMARY KEY (belt, second)
) WITHOUT ROWID, STRICT;
CREATE TABLE IF NOT EXISTS gaps (
    belt TEXT NOT NULL, from_ms INTEGER NOT NULL, to_ms INTEGER NOT NULL, reason TEXT NOT NULL,
    PRIMARY KEY (belt, from_ms, reason)
) WITHOUT ROWID, STRICT;
CREATE INDEX IF NOT EXISTS gaps_of_belt ON gaps (belt, to_ms);
CREATE TABLE IF NOT EXISTS balances (
    name TEXT NOT NULL, start_ms INTEGER NOT NULL, end_ms INTEGER NOT NULL, state TEXT NOT NULL,
    inflow REAL, outflow REAL, sigma REAL, reason TEXT NOT NULL, belt TEXT NOT NULL,
    PRIMARY KEY (name, start_ms)
) WITHOUT ROWID, STRICT;
"""


class SiteStore:
    """Sums, cursors, gaps and balances. Thread-safe."""

    def __init__(self, folder: Path) -> None:
        """Open or create the database; OutputError if it cannot be used."""
        self._path, self._lock = folder / FILE, RLock()
        try:
            self._connection = sqlite3.connect(self._path, check_same_thread=False, isolation_level=None)
            try:
                _prepare(self._connection, self._path)
            except BaseException:
                self._connection.close()
                raise
        except sqlite3.Error as error:
            fix = "; remove it to fetch all anew" if is_damage(error) else ""
            raise OutputError(
                f"{self._path}: not opened: {describe_failure(self._path, error)}{fix}"
            ) from error

    def read_cursor(self, belt: str) -> Cursor | None:
        """Return the last record of a belt that is counted; None: there is none yet."""
        rows = self._select("SELECT number, run, wall_ms, mark FROM belts WHERE belt = ?", belt)
        return Cursor(*rows[0]) if rows else None

    def read_complete_ms(self, belt: str) -> int:
        """Return the time until which a belt's ledger is known completely; 0: it is not yet known."""
        rows = self._select("SELECT complete_ms FROM belts WHERE belt = ?", belt)
        return rows[0][0] if rows else 0

    def add(self, belt: str, before: Cursor | None, batch: PieceSums) -> None:
        """Add a piece of a ledger, and set the cursor behind it.

        Nothing is added where the cursor is not ``before`` any more, since another program has counted meanwhile.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        end = batch.cursor
        with self._write() as connection:
            if self.read_cursor(belt) != before:
                return
            connection.execute(
                "INSERT INTO belts (belt, number, run, wall_ms, mark) VALUES (?, ?, ?, ?, ?) ON CONFLICT (belt) DO"
                " UPDATE SET number = excluded.number, run = excluded.run, wall_ms = excluded.wall_ms,"
                " mark = excluded.mark",
                (belt, end.number, end.run, end.wall_ms, end.mark),
            )
            _add_sums(connection, "seconds", belt, batch.seconds)
            _add_sums(connection, "quarters", belt, batch.quarters)
            _add_gaps(connection, belt, batch.gaps)

    def set_complete(self, belt: str, complete_ms: int) -> None:
        """Record that a belt's ledger is known up to a time; it never goes back."""
        with self._write() as connection:
            connection.execute(
                "UPDATE belts SET complete_ms = max(complete_ms, ?) WHERE belt = ?", (complete_ms, belt)
            )

    def add_gap(self, belt: str, gap: Gap) -> None:
        """Record a period of which it is not known what passed."""
        with self._write() as connection:
            _add_gaps(connection, belt, (gap,))

    def read_gaps(self, belt: str, from_ms: int, to_ms: int) -> list[Gap]:
        """Return the gaps of a belt that reach into a period."""
        query = "SELECT from_ms, to_ms, reason FROM gaps WHERE belt = ? AND to_ms > ? AND from_ms < ?"
        return [Gap(*row) for row in self._select(query, belt, from_ms, to_ms)]

    def read_seconds(self, belt: str, first: int, end: int) -> dict[int, RecordSums]:
        """Return the sums of a belt by seconds from ``first`` to before ``end``, those without a record left out."""
        return self._read_sums("seconds", belt, first, end)

    def read_quarters(self, belt: str, first: int, end: int) -> dict[int, RecordSums]:
        """Return the sums of a belt by quarters of an hour that begin from ``first`` to before ``end``."""
        return self._read_sums("quarters", belt, first, end)

    def read_first_second(self, belt: str) -> int | None:
        """Return the first second of a belt that is kept; None without a record."""
        return self._select("SELECT min(second) FROM seconds WHERE belt = ?", belt)[0][0]

    def read_first_quarter(self, belt: str) -> int | None:
        """Return the beginning of the first quarter of an hour of a belt, s since 1970; None without a record."""
        return self._select("SELECT min(second) FROM quarters WHERE belt = ?", belt)[0][0]

    def add_balance(self, name: str, result: BalanceResult) -> None:
        """Keep the balance of a window."""
        with self._write() as connection:
            connection.execute(
                "INSERT OR REPLACE INTO balances VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    *(name, result.start_ms, result.end_ms, result.state),
                    *(result.inflow, result.outflow, result.sigma, result.reason, result.belt),
                ),
            )

    def read_balances(self, name: str, limit: int) -> list[BalanceResult]:
        """Return the newest balances of a transfer point, oldest first."""
        query = (
            "SELECT start_ms, end_ms, state, inflow, outflow, sigma, reason, belt FROM balances WHERE name = ?"
            " ORDER BY start_ms DESC LIMIT ?"
        )
        return [BalanceResult(*row) for row in self._select(query, name, limit)][::-1]

    def prune(self, before_s: int) -> None:
        """Remove sums by seconds, and gaps, of before that time."""
        with self._write() as connection:
            connection.execute("DELETE FROM seconds WHERE second < ?", (before_s,))
            connection.execute("DELETE FROM gaps WHERE to_ms < ?", (before_s * 1000,))

    def close(self) -> None:
        """Close the database."""
        with self._lock:
            self._connection.close()

    def _read_sums(self, table: str, belt: str, first: int, end: int) -> dict[int, RecordSums]:
        query = (
            f"SELECT second, {_COLUMNS} FROM {table} WHERE belt = ? AND second >= ? AND second < ? ORDER BY 1"
        )
        return {row[0]: RecordSums(int(row[1]), *row[2:]) for row in self._select(query, belt, first, end)}

    def _select(self, query: str, *values: str | int) -> list[Any]:
        with self._lock:
            return self._connection.execute(query, values).fetchall()

    @contextmanager
    def _write(self) -> Generator[sqlite3.Connection]:
        with self._lock:
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException as error:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                if isinstance(error, sqlite3.Error):
                    raise OutputError(
                        f"{self._path}: not written: {describe_failure(self._path, error)}"
                    ) from error
                raise


def _prepare(connection: sqlite3.Connection, path: Path) -> None:
    """Create the tables that are missing; OutputError, with nothing written, if the file is of a newer version."""
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version > _VERSION:
        raise OutputError(f"{path}: is of a newer version of Beltscape; update this one")
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = NORMAL")
    connection.executescript(_TABLES)
    connection.execute(f"PRAGMA user_version = {_VERSION}")


def _add_sums(
    connection: sqlite3.Connection, table: str, belt: str, sums_of: Mapping[int, RecordSums]
) -> None:
    added = ", ".join(f"{name} = {name} + excluded.{name}" for name in FIELDS)
    connection.executemany(
        f"INSERT INTO {table} VALUES (?, ?, {', '.join('?' * len(FIELDS))}) ON CONFLICT DO UPDATE SET {added}",
        [(belt, second, *(getattr(sums, name) for name in FIELDS)) for second, sums in sums_of.items()],
    )


def _add_gaps(connection: sqlite3.Connection, belt: str, gaps: tuple[Gap, ...]) -> None:
    connection.executemany(
        "INSERT INTO gaps VALUES (?, ?, ?, ?) ON CONFLICT DO UPDATE SET to_ms = max(to_ms, excluded.to_ms)",
        [(belt, gap.from_ms, gap.to_ms, gap.reason) for gap in gaps],
    )
