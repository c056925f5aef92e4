"""Writing of production: sums by minute, product and batch, product changes, batches, readings of a belt scale."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import astuple
from pathlib import Path

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.production.scale import ScaleReading
from beltscape.production.sums import COLUMNS, ProductionSums, sum_record

MINUTE_NS = 60_000_000_000
"""Nanoseconds of a minute."""
_TABLES = ("product_changes", "batches", "scale_readings")
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
        ((*key, *astuple(sums)) for key, sums in found.items()),
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
