"""Reading of records of any period from the database and from day files, each once."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.belt.ledger_entries import BeltRecord, CrossSection
from beltscape.sinks.days import DAY_NS, format_day
from beltscape.sinks.historian.reading.records import read_database_records, read_database_section
from beltscape.sinks.historian.reading.series import find_number_range
from beltscape.sinks.historian.storage.day_files import UNBOUNDED, read_day


@dataclass(frozen=True, slots=True)
class DaySum:
    """Sums of one day."""

    day: str
    """Such as 2026-11-21."""
    records: int
    volume_mm3: float
    mass_kg: float
    """NaN if a density is not known."""
    valid_mm: float
    degraded_mm: float
    missing_mm: float


def read_records(
    connection: sqlite3.Connection,
    folder: Path,
    times_ns: tuple[int, int],
    after: int,
    limit: int,
    shift_ns: int,
    *,
    sections: bool,
) -> tuple[BeltRecord, ...]:
    """Return the first ``limit`` records of a period with numbers above ``after``; day files are in ``folder``."""
    found: dict[int, BeltRecord] = {}
    numbers = find_number_range(connection, *times_ns, shift_ns)
    if numbers is not None:
        bounds = max(numbers[0], after + 1), numbers[1]
        for record in read_database_records(connection, bounds, times_ns, limit, sections=sections):
            found[record.number] = record
    files = connection.execute(
        "SELECT name, first FROM files WHERE pruned AND until_ns >= ? AND since_ns < ? AND last > ? ORDER BY first",
        (*times_ns, after),
    )
    for name, first in files:
        if len(found) >= limit and first > sorted(found)[limit - 1]:
            break
        for record in _read_day_file(
            folder / name, (after + 1, UNBOUNDED), times_ns, limit, sections=sections
        ):
            found[record.number] = record
    return tuple(found[number] for number in sorted(found)[:limit])


def read_section(connection: sqlite3.Connection, folder: Path, number: int) -> CrossSection | None:
    """Return the cross-section of a record; None without a stored one."""
    section = read_database_section(connection, number)
    if section is not None:
        return section
    files = connection.execute("SELECT name FROM files WHERE pruned AND ? BETWEEN first AND last", (number,))
    for (name,) in files:
        for record in _read_day_file(
            folder / name, (number, number), (-UNBOUNDED, UNBOUNDED), 1, sections=True
        ):
            return record.section
    return None


def read_day_sums(
    connection: sqlite3.Connection, since_ns: int, until_ns: int, shift_ns: int
) -> tuple[DaySum, ...]:
    """Return the sums of the days that begin in a period, oldest first."""
    first, last = -((shift_ns - since_ns) // DAY_NS), -((shift_ns - until_ns) // DAY_NS)
    rows = connection.execute(
        "SELECT bucket / 24, sum(records), total(volume), iif(sum(unweighed), 'nan', total(mass)), total(valid), "
        "total(degraded), total(missing) FROM hours WHERE bucket >= ? AND bucket < ? GROUP BY bucket / 24",
        (24 * first, 24 * last),
    )
    return tuple(DaySum(format_day(row[0]), row[1], row[2], float(row[3]), *row[4:]) for row in rows)


def _read_day_file(
    path: Path, numbers: tuple[int, int], times_ns: tuple[int, int], limit: int, *, sections: bool
) -> list[BeltRecord]:
    """Read records of a day file; an empty list if the file has just been removed."""
    try:
        return read_day(path, numbers, times_ns, limit, sections=sections)
    except FileNotFoundError:
        return []
