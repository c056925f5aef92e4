"""Records and sections read back from the database."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from beltscape.core.belt.ledger_entries import BeltRecord, CrossSection
from beltscape.sinks.historian.storage.rows import COLUMNS, SELECT, from_row
from beltscape.sinks.historian.storage.sections import unpacked

_WITH_SECTIONS = SELECT.replace(" FROM records", ", grids.x, sections.height FROM records") + (
    " LEFT JOIN sections ON sections.number = records.number LEFT JOIN grids ON grids.grid = sections.grid"
)
_WHERE = (
    " WHERE records.number BETWEEN ? AND ? AND records.wall_ns >= ? AND records.wall_ns < ?"
    " ORDER BY records.number LIMIT ?"
)


def database_records(
    connection: sqlite3.Connection,
    numbers: tuple[int, int],
    times_ns: tuple[int, int],
    limit: int,
    *,
    sections: bool,
) -> Iterator[BeltRecord]:
    """Records with such numbers (both ends in) and times (end out), in order of their numbers."""
    rows = connection.execute(
        f"{_WITH_SECTIONS if sections else SELECT}{_WHERE}",
        (*numbers, *times_ns, limit),
    )
    width = len(COLUMNS)
    for row in rows:
        yield from_row(row[:width], section_of(row[width:]) if sections else None)


def database_rows(
    connection: sqlite3.Connection, numbers: tuple[int, int], times_ns: tuple[int, int], limit: int
) -> tuple[list[Sequence[Any]], list[CrossSection | None]]:
    """As ``database_records``, as rows in the order of the columns, and their sections."""
    rows = connection.execute(f"{_WITH_SECTIONS}{_WHERE}", (*numbers, *times_ns, limit)).fetchall()
    width = len(COLUMNS)
    return [row[:width] for row in rows], [section_of(row[width:]) for row in rows]


def database_section(connection: sqlite3.Connection, number: int) -> CrossSection | None:
    """The cross-section behind that record; None where none is kept."""
    row = connection.execute(
        "SELECT grids.x, height FROM sections JOIN grids USING (grid) WHERE number = ?", (number,)
    ).fetchone()
    return None if row is None else section_of(row)


def section_of(row: Sequence[bytes | None]) -> CrossSection | None:
    """Of the two blobs; None where there are none."""
    x, height = row
    if x is None or height is None:
        return None
    return CrossSection(np.frombuffer(x, "<f4").astype(np.float32), unpacked(height))
