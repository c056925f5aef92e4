"""Production in the database: sums by minute, product and batch, product changes, batches, scale readings.

All of them are written and read here; `production_history` does so for other threads.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beltscape.core.ledger import BeltRecord
from beltscape.production.scale import ScaleReading
from beltscape.production.sums import COLUMNS, Batch, ProductionSums, sum_record

MINUTE_NS = 60_000_000_000
"""Nanoseconds of a minute."""
_TABLES = ("product_changes", "batches", "scale_readings", "rig_drift")
"""Tables that no day file repeats."""


def add_to_production(connection: sqlite3.Connection, records: Sequence[BeltRecord]) -> None:
    """Add records to the sums within the open transaction."""
    found: dict[tuple[int, str, int], ProductionSums] = {}
    for record in records:
        key = int(record.wall_ns) // MINUTE_NS, record.product, record.batch
        found[key] = found.get(key, ProductionSums()) + sum_record(record)
    marks = ", ".join("?" * (3 + len(COLUMNS)))
    added = ", ".join(f"{name} = {name} + excluded.{name}" for name in COLUMNS)
    connection.executemany(
        f"INSERT INTO production_sums (minute, product, batch, {', '.join(COLUMNS)}) VALUES ({marks}) "
        f"ON CONFLICT (minute, product, batch) DO UPDATE SET {added}",
        ((*key, *(getattr(sums, name) for name in COLUMNS)) for key, sums in found.items()),
    )


def insert_product_change(connection: sqlite3.Connection, wall_ns: int, product: str, by: str) -> None:
    """Make a product the present one."""
    connection.execute(
        "INSERT INTO product_changes (wall_ns, product, by) VALUES (?, ?, ?)", (wall_ns, product, by)
    )


def insert_batch(connection: sqlite3.Connection, number: int, name: str, wall_ns: int, by: str) -> int:
    """Open a batch with at least ``number``; return its number. Another must not be open."""
    (last,) = connection.execute("SELECT coalesce(max(batch), 0) FROM batches").fetchone()
    number = max(number, last + 1)
    connection.execute(
        "INSERT INTO batches (batch, name, started_ns, started_by) VALUES (?, ?, ?, ?)",
        (number, name, wall_ns, by),
    )
    return number


def end_batch(connection: sqlite3.Connection, wall_ns: int, by: str) -> None:
    """End the open batch, if there is one."""
    connection.execute(
        "UPDATE batches SET ended_ns = max(?, started_ns), ended_by = ? WHERE ended_ns IS NULL", (wall_ns, by)
    )


def insert_readings(connection: sqlite3.Connection, readings: Iterable[ScaleReading]) -> None:
    """Store readings of a scale; a later one of the same instant replaces the former."""
    connection.executemany(
        "INSERT OR REPLACE INTO scale_readings (wall_ns, kg, source, by) VALUES (?, ?, ?, ?)",
        ((reading.wall_ns, reading.kg, reading.source, reading.by) for reading in readings),
    )


def forget_production(connection: sqlite3.Connection, until_ns: int) -> None:
    """Remove sums and readings up to an instant; those of batches stay."""
    connection.execute("DELETE FROM production_sums WHERE batch = 0 AND minute < ?", (until_ns // MINUTE_NS,))
    connection.execute("DELETE FROM scale_readings WHERE wall_ns < ?", (until_ns,))


def salvage_production(damaged: Path, connection: sqlite3.Connection) -> None:
    """Copy what is readable of a damaged database's batches, product changes and readings; within a transaction."""
    with (
        suppress(sqlite3.Error),
        closing(sqlite3.connect(f"{damaged.absolute().as_uri()}?mode=ro", uri=True)) as old,
    ):
        for table in _TABLES:
            with suppress(sqlite3.Error):
                for row in old.execute(f"SELECT * FROM {table}"):
                    marks = ", ".join("?" * len(row))
                    connection.execute(f"INSERT OR IGNORE INTO {table} VALUES ({marks})", row)


_TOTALS = ", ".join(f"{'sum' if name in ('records', 'unweighed') else 'total'}({name})" for name in COLUMNS)
_BATCH = "SELECT batch, name, started_ns, started_by, ended_ns, ended_by FROM batches"


@dataclass(frozen=True, slots=True)
class ProductChange:
    """A change of the present product."""

    wall_ns: int
    product: str
    by: str


def read_product_sums(
    connection: sqlite3.Connection, since_ns: int, until_ns: int
) -> dict[str, ProductionSums]:
    """Return the sums of every product in the minutes that begin in a period."""
    rows = connection.execute(
        f"SELECT product, {_TOTALS} FROM production_sums WHERE minute >= ? AND minute < ? GROUP BY product",
        (-(-since_ns // MINUTE_NS), -(-until_ns // MINUTE_NS)),
    )
    return {row[0]: ProductionSums(*row[1:]) for row in rows}


def read_last_change(connection: sqlite3.Connection) -> ProductChange | None:
    """Return the last change of the product; None before the first."""
    row = connection.execute(
        "SELECT wall_ns, product, by FROM product_changes ORDER BY change DESC LIMIT 1"
    ).fetchone()
    return None if row is None else ProductChange(*row)


def read_changes(connection: sqlite3.Connection, since_ns: int, until_ns: int) -> tuple[ProductChange, ...]:
    """Return the changes of the product in a period, oldest first."""
    rows = connection.execute(
        "SELECT wall_ns, product, by FROM product_changes WHERE wall_ns >= ? AND wall_ns < ? ORDER BY change",
        (since_ns, until_ns),
    )
    return tuple(ProductChange(*row) for row in rows)


def read_batches(
    connection: sqlite3.Connection, since_ns: int, until_ns: int, limit: int
) -> tuple[Batch, ...]:
    """Return the batches that touch a period, newest first."""
    rows = connection.execute(
        f"{_BATCH} WHERE started_ns < ? AND coalesce(ended_ns, ?) >= ? ORDER BY batch DESC LIMIT ?",
        (until_ns, until_ns, since_ns, limit),
    ).fetchall()
    return _make_batches(connection, rows)


def read_open_batch(connection: sqlite3.Connection) -> Batch | None:
    """Return the open batch; None without one."""
    row = connection.execute(f"{_BATCH} WHERE ended_ns IS NULL").fetchone()
    return None if row is None else _make_batches(connection, [row])[0]


def read_batch(connection: sqlite3.Connection, number: int) -> Batch | None:
    """Return the batch of a number; None if there is none."""
    row = connection.execute(f"{_BATCH} WHERE batch = ?", (number,)).fetchone()
    return None if row is None else _make_batches(connection, [row])[0]


def _make_batches(connection: sqlite3.Connection, rows: Sequence[Sequence[Any]]) -> tuple[Batch, ...]:
    """Return the batches of rows in falling order of their numbers, with their sums."""
    if not rows:
        return ()
    by_batch: dict[int, list[tuple[str, ProductionSums]]] = {}
    found = connection.execute(
        f"SELECT batch, product, {_TOTALS} FROM production_sums WHERE batch BETWEEN ? AND ? AND batch > 0 "
        "GROUP BY batch, product ORDER BY batch, product",
        (rows[-1][0], rows[0][0]),
    )
    for batch, product, *sums in found:
        by_batch.setdefault(batch, []).append((product, ProductionSums(*sums)))
    newest = connection.execute("SELECT batch FROM records ORDER BY number DESC LIMIT 1").fetchone()
    batches: list[Batch] = []
    for number, name, started_ns, started_by, ended_ns, ended_by in rows:
        sums = tuple(by_batch.get(number, ()))
        # some of its belt is in view until a record of another batch, or none, follows
        is_complete = ended_ns is not None and (newest is None or newest[0] != number)
        batches.append(Batch(number, name, started_ns, started_by, ended_ns, ended_by, sums, is_complete))
    return tuple(batches)


def read_readings(connection: sqlite3.Connection, since_ns: int, until_ns: int) -> tuple[ScaleReading, ...]:
    """Return the readings of the scale in a period and the ones right before and after it, in the order of time."""
    rows = connection.execute(
        "SELECT wall_ns, kg, source, by FROM scale_readings WHERE wall_ns BETWEEN "
        "coalesce((SELECT max(wall_ns) FROM scale_readings WHERE wall_ns <= ?1), ?1) AND "
        "coalesce((SELECT min(wall_ns) FROM scale_readings WHERE wall_ns >= ?2), ?2) ORDER BY wall_ns",
        (since_ns, until_ns),
    )
    return tuple(ScaleReading(*row) for row in rows)


def read_last_reading(connection: sqlite3.Connection) -> ScaleReading | None:
    """Return the newest reading of the scale; None without one."""
    row = connection.execute(
        "SELECT wall_ns, kg, source, by FROM scale_readings ORDER BY wall_ns DESC LIMIT 1"
    ).fetchone()
    return None if row is None else ScaleReading(*row)
