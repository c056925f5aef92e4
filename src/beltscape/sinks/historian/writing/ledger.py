"""The one writer of the database: records, their sections, sums and totals in one transaction."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Sequence

import numpy as np

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import InputError
from beltscape.sinks.historian.storage.rows import INSERT, to_row
from beltscape.sinks.historian.storage.sections import packed
from beltscape.sinks.historian.writing.buckets import add_to_buckets
from beltscape.sinks.historian.writing.sums import Sums


def append(
    connection: sqlite3.Connection,
    sums: Sums,
    records: Sequence[BeltRecord],
    shift_ns: int,
    *,
    sections: bool,
) -> Sums:
    """Keep what is new of ``records``, all or nothing; the sums after it. On disk when this returns.

    Raises
    ------
    InputError
        When a record does not go on where the ledger ended, or is another than the one kept under its number.
    sqlite3.Error
        When it cannot be written; nothing has changed then.
    """
    new = _fresh(connection, sums, records)
    if not new:
        return sums
    after = sums
    for record in new:
        after = after.with_record(record)
    with transaction(connection):
        connection.executemany(INSERT, map(to_row, new))
        if sections:
            _keep_sections(connection, new)
        add_to_buckets(connection, new, shift_ns)
        connection.execute("UPDATE ledger SET state = ?", (after.text(),))
    return after


class transaction:  # noqa: N801  (reads like a word of the language)
    """``with transaction(connection):`` all of the block or nothing."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def __enter__(self) -> None:
        """Take the writer's place."""
        self._connection.execute("BEGIN IMMEDIATE")

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        """Commit, or roll back on any exception, that of the commit included."""
        try:
            if kind is None:
                self._connection.execute("COMMIT")
        finally:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")


def _fresh(connection: sqlite3.Connection, sums: Sums, records: Sequence[BeltRecord]) -> list[BeltRecord]:
    """The records that are not kept yet, each checked to go on where the one before ended."""
    new: list[BeltRecord] = []
    number, end_mm = sums.number, sums.end_mm
    for record in records:
        if record.number <= sums.number:
            _same(connection, record)
            continue
        start, end = map(float, record.belt_mm)
        if record.number != number + 1:
            raise InputError(
                f"record {record.number}: the ledger goes on with number {number + 1}; none may be left out"
            )
        if not (math.isfinite(start) and math.isfinite(end) and end >= start):
            raise InputError(
                f"record {number + 1}: its belt from {start!r} to {end!r} mm is no stretch that goes forward"
            )
        if end_mm is not None and start != end_mm:
            raise InputError(
                f"record {number + 1}: it begins at {start!r} mm, the ledger ends at {end_mm!r} mm; they must meet"
            )
        new.append(record)
        number, end_mm = number + 1, end
    return new


def _same(connection: sqlite3.Connection, record: BeltRecord) -> None:
    """InputError where another stretch of belt is kept under its number; pruned ones are believed."""
    kept = connection.execute(
        "SELECT from_mm, to_mm FROM records WHERE number = ?", (record.number,)
    ).fetchone()
    if kept is not None and kept != tuple(map(float, record.belt_mm)):
        raise InputError(
            f"record {record.number}: it is already kept for {kept[0]!r} to {kept[1]!r} mm, not "
            f"{record.belt_mm[0]!r} to {record.belt_mm[1]!r} mm; go on from the historian's resume"
        )


def _keep_sections(connection: sqlite3.Connection, records: Sequence[BeltRecord]) -> None:
    grids: dict[bytes, int] = {}
    rows: list[tuple[int, int, bytes]] = []
    for record in records:
        if record.section is None:
            continue
        x = np.ascontiguousarray(record.section.x_mm, "<f4").tobytes()
        if x not in grids:
            grids[x] = _grid(connection, x)
        rows.append((record.number, grids[x], packed(record.section.height_mm)))
    connection.executemany("INSERT INTO sections (number, grid, height) VALUES (?, ?, ?)", rows)


def _grid(connection: sqlite3.Connection, x: bytes) -> int:
    """Number of the grid, kept once for all sections on it."""
    found = connection.execute("SELECT grid FROM grids WHERE x = ?", (x,)).fetchone()
    if found is None:
        return int(connection.execute("INSERT INTO grids (x) VALUES (?)", (x,)).lastrowid or 0)
    return int(found[0])
