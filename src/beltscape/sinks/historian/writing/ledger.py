"""Appending records to the ledger, with sections, sums and totals, in one transaction."""

from __future__ import annotations

import math
import sqlite3
import time
from collections.abc import Sequence

import numpy as np

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import InputError
from beltscape.sinks.historian.storage.rows import INSERT, to_row
from beltscape.sinks.historian.storage.sections import pack_heights
from beltscape.sinks.historian.writing.buckets import add_to_buckets
from beltscape.sinks.historian.writing.sums import Sums


def append_records(
    connection: sqlite3.Connection,
    sums: Sums,
    records: Sequence[BeltRecord],
    shift_ns: int,
    *,
    sections: bool,
) -> Sums:
    """Store all or none of the new ``records``; return the sums after them. They are on disk when this returns.

    Raises
    ------
    InputError
        When a record does not continue the ledger, or differs from the one stored under its number.
    sqlite3.Error
        When they cannot be written; nothing has changed then.
    """
    new = _select_new(connection, sums, records)
    if not new:
        return sums
    after = sums
    for record in new:
        after = after.add_record(record)
    with transaction(connection):
        connection.executemany(INSERT, map(to_row, new))
        if sections:
            _keep_sections(connection, new)
        add_to_buckets(connection, new, shift_ns)
        connection.execute("UPDATE ledger SET state = ?", (after.text(),))
    return after


class transaction:  # noqa: N801  (a context manager, used like a keyword)
    """Context manager that commits the whole block or nothing."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def __enter__(self) -> None:
        """Begin the transaction."""
        self._connection.execute("BEGIN IMMEDIATE")

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        """Commit, or roll back on any exception, that of the commit included."""
        try:
            if kind is None:
                self._connection.execute("COMMIT")
        finally:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")


def set_sums(connection: sqlite3.Connection, sums: Sums) -> None:
    """Let the ledger end, and add up, as ``sums`` says; within a transaction."""
    connection.execute(
        "UPDATE ledger SET number = ?, run = ?, end_mm = ?, state = ?",
        (sums.number, sums.run, sums.end_mm, sums.text()),
    )
    connection.execute("INSERT OR IGNORE INTO runs (run, wall_ns) VALUES (?, ?)", (sums.run, time.time_ns()))


def _select_new(
    connection: sqlite3.Connection, sums: Sums, records: Sequence[BeltRecord]
) -> list[BeltRecord]:
    """Return the records that are not stored yet, each checked to continue the previous one."""
    new: list[BeltRecord] = []
    number, end_mm = sums.number, sums.end_mm
    for record in records:
        if record.number <= sums.number:
            _require_same(connection, record)
            continue
        start, end = map(float, record.belt_mm)
        if record.number != number + 1:
            raise InputError(
                f"record {record.number}: the ledger continues with number {number + 1}; none may be missing"
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


def _require_same(connection: sqlite3.Connection, record: BeltRecord) -> None:
    """Raise InputError if another stretch is stored under the record's number; removed ones are not checked."""
    stored = connection.execute(
        "SELECT from_mm, to_mm FROM records WHERE number = ?", (record.number,)
    ).fetchone()
    if stored is not None and stored != tuple(map(float, record.belt_mm)):
        raise InputError(
            f"record {record.number}: it is already stored for {stored[0]!r} to {stored[1]!r} mm, not "
            f"{record.belt_mm[0]!r} to {record.belt_mm[1]!r} mm; continue from the historian's ledger_end"
        )


def _keep_sections(connection: sqlite3.Connection, records: Sequence[BeltRecord]) -> None:
    grids: dict[bytes, int] = {}
    rows: list[tuple[int, int, bytes]] = []
    for record in records:
        if record.section is None:
            continue
        x = np.ascontiguousarray(record.section.x_mm, "<f4").tobytes()
        if x not in grids:
            grids[x] = _grid_number(connection, x)
        rows.append((record.number, grids[x], pack_heights(record.section.height_mm)))
    connection.executemany("INSERT INTO sections (number, grid, height) VALUES (?, ?, ?)", rows)


def _grid_number(connection: sqlite3.Connection, x: bytes) -> int:
    """Return the number of the grid, which is stored once for all its sections."""
    row = connection.execute("SELECT grid FROM grids WHERE x = ?", (x,)).fetchone()
    if row is None:
        return int(connection.execute("INSERT INTO grids (x) VALUES (?)", (x,)).lastrowid or 0)
    return int(row[0])
