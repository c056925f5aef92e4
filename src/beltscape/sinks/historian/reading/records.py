"""Reading of records and sections from the database."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from beltscape.core.belt.ledger_entries import BeltRecord, CrossSection
from beltscape.sinks.historian.storage.rows import COLUMNS, SELECT, from_row
from beltscape.sinks.historian.storage.sections import unpack_heights

_WITH_SECTIONS = SELECT.replace(" FROM records", ", grids.x, sections.height FROM records") + (
    " LEFT JOIN sections ON sections.number = records.number LEFT JOIN grids ON grids.grid = sections.grid"
)
_WHERE = (
    " WHERE records.number BETWEEN ? AND ? AND records.wall_ns >= ? AND records.wall_ns < ?"
    " ORDER BY records.number LIMIT ?"
)


def read_database_records(
    connection: sqlite3.Connection,
    numbers: tuple[int, int],
    times_ns: tuple[int, int],
    limit: int,
    *,
    sections: bool,
) -> Iterator[BeltRecord]:
    """Yield the records in a range of numbers (ends included) and times (end excluded), in order of their numbers."""
    rows = connection.execute(
        f"{_WITH_SECTIONS if sections else SELECT}{_WHERE}",
        (*numbers, *times_ns, limit),
    )
    width = len(COLUMNS)
    for row in rows:
        yield from_row(row[:width], decode_section(row[width:]) if sections else None)


def read_database_rows(
    connection: sqlite3.Connection, numbers: tuple[int, int], times_ns: tuple[int, int], limit: int
) -> tuple[list[Sequence[Any]], list[CrossSection | None]]:
    """Return the records of such a range as rows in the order of the columns, and their sections."""
    rows = connection.execute(f"{_WITH_SECTIONS}{_WHERE}", (*numbers, *times_ns, limit)).fetchall()
    width = len(COLUMNS)
    return [row[:width] for row in rows], [decode_section(row[width:]) for row in rows]


def read_database_section(connection: sqlite3.Connection, number: int) -> CrossSection | None:
    """Return the cross-section of a record; None without a stored one."""
    row = connection.execute(
        "SELECT grids.x, height FROM sections JOIN grids USING (grid) WHERE number = ?", (number,)
    ).fetchone()
    return None if row is None else decode_section(row)


def decode_section(row: Sequence[bytes | None]) -> CrossSection | None:
    """Return the cross-section of the two blobs; None without blobs."""
    x, height = row
    if x is None or height is None:
        return None
    return CrossSection(np.frombuffer(x, "<f4").astype(np.float32), unpack_heights(height))
