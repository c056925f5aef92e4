"""Reading of any period: its records from the database and from day files, each once, and its series.

A series has a few hundred intervals.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.ledger import BeltRecord, CrossSection
from beltscape.sinks.days import DAY_NS, HOUR_NS, format_day
from beltscape.sinks.historian.day_files import UNBOUNDED, read_day
from beltscape.sinks.historian.ledger import ADDED_COLUMNS, BUCKET_WIDTH_NS
from beltscape.sinks.historian.records import read_database_records, read_database_section

_RAW_NS = HOUR_NS // 2
"""A shorter period is computed from the records themselves: 30 points of a minute would be coarse."""
_MINUTES_NS = 14 * 24 * HOUR_NS
"""A longer period is computed from the sums by the hour: 20,160 minutes are read in some tenths of a second."""
_NUMBERS_NS = 48 * HOUR_NS
"""In a longer period the records' numbers are searched by the hour, which is precise enough and faster."""
Curve = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Sums and means over n equal intervals; an interval without records has NaN means and zero sums."""

    start_ns: NDArray[np.int64]
    """(n,) system clock at which each interval begins, ns since 1970."""
    width_ns: int
    """Length of each interval."""
    records: NDArray[np.int64]
    """(n,) records in each."""
    volume_mm3: Curve
    """(n,) volume that passed."""
    mass_kg: Curve
    """(n,) mass that passed; NaN where a density is not known."""
    flow_m3_h: Curve
    """(n,) mean volume flow while the belt moved; 0 where it stood, NaN: not known."""
    flow_low_m3_h: Curve
    """(n,) least flow of any record."""
    flow_high_m3_h: Curve
    """(n,) greatest flow of any record."""
    mass_flow_t_h: Curve
    """(n,) mean mass flow while the belt moved."""
    speed_mm_s: Curve
    """(n,) mean speed while the belt moved."""
    coverage: Curve
    """(n,) mean share of the belt that was measured, 0..1."""
    valid_mm: Curve
    degraded_mm: Curve
    missing_mm: Curve
    """(n,) length of belt by standing."""


def read_series(
    connection: sqlite3.Connection, since_ns: int, until_ns: int, points: int, shift_ns: int
) -> Series:
    """Return the series from ``since_ns`` to before ``until_ns`` in at most ``points`` intervals.

    Periods longer than half an hour are computed from the sums by minute or hour, with multiples of their intervals.
    """
    span = max(1, until_ns - since_ns)
    if span <= _RAW_NS and _has_records(connection, since_ns, until_ns, shift_ns):
        width = math.ceil(span / points)
        return _series(
            _raw(connection, since_ns, until_ns, width, shift_ns), since_ns, width, math.ceil(span / width)
        )
    table = "minutes" if _has_minutes(connection, since_ns, span, shift_ns) else "hours"
    unit = BUCKET_WIDTH_NS[table]
    first, last = (since_ns - shift_ns) // unit, -((shift_ns - until_ns) // unit)
    times = max(1, math.ceil((last - first) / points))
    sums = ", ".join(f"total({name})" for name in ADDED_COLUMNS)
    rows = connection.execute(
        f"SELECT (bucket - :first) / :times AS place, {sums}, min(flow_low), max(flow_high) FROM {table} "
        "WHERE bucket >= :first AND bucket < :last GROUP BY place",
        {"first": first, "last": last, "times": times},
    ).fetchall()
    count = max(1, math.ceil((last - first) / times))
    return _series(rows, first * unit + shift_ns, times * unit, count)


def find_number_range(
    connection: sqlite3.Connection, since_ns: int, until_ns: int, shift_ns: int
) -> tuple[int, int] | None:
    """Return the least and the greatest number of the records of a period or near it; None without records.

    They come from the sums: the clock may have jumped, so the order of numbers and times may differ.
    """
    table = "minutes" if until_ns - since_ns <= _NUMBERS_NS else "hours"
    unit = BUCKET_WIDTH_NS[table]
    first, last = (since_ns - shift_ns) // unit, -((shift_ns - until_ns) // unit)
    low, high = connection.execute(
        f"SELECT min(first), max(last) FROM {table} WHERE bucket >= ? AND bucket < ?", (first, last)
    ).fetchone()
    return None if low is None else (low, high)


def _has_records(connection: sqlite3.Connection, since_ns: int, until_ns: int, shift_ns: int) -> bool:
    """Return whether the records of a period are still in the table of records."""
    numbers = find_number_range(connection, since_ns, until_ns, shift_ns)
    oldest = connection.execute("SELECT min(number) FROM records").fetchone()[0]
    return numbers is None or (oldest is not None and oldest <= numbers[0])


def _has_minutes(connection: sqlite3.Connection, since_ns: int, span_ns: int, shift_ns: int) -> bool:
    """Return whether sums by the minute reach back to ``since_ns`` and are not too many."""
    if span_ns > _MINUTES_NS:
        return False
    hour = connection.execute(
        "SELECT min(bucket) FROM hours WHERE bucket >= ?", ((since_ns - shift_ns) // HOUR_NS,)
    ).fetchone()[0]
    minute = connection.execute("SELECT min(bucket) FROM minutes").fetchone()[0]
    return hour is None or (minute is not None and minute // 60 <= hour)


def _raw(
    connection: sqlite3.Connection, since_ns: int, until_ns: int, width_ns: int, shift_ns: int
) -> list[Sequence[Any]]:
    """Return sums of records, computed in the database, in the columns of the sums' tables."""
    numbers = find_number_range(connection, since_ns, until_ns, shift_ns)
    if numbers is None:
        return []
    return connection.execute(
        """SELECT (wall_ns - :since) / :width AS place, count(*),
            total(volume), total(volume * density) * 1e-9, total(volume <> 0 AND density IS NULL),
            total(iif(standing = 0, to_mm - from_mm, 0)), total(iif(standing = 1, to_mm - from_mm, 0)),
            total(iif(standing = 2, to_mm - from_mm, 0)),
            total(iif(speed > 0 AND area IS NOT NULL, volume, 0)),
            total(iif(speed > 0 AND area IS NOT NULL, volume * density, 0)) * 1e-9,
            total(iif(speed > 0 AND area IS NOT NULL, to_mm - from_mm, 0)),
            total(iif(speed > 0 AND area IS NOT NULL, (to_mm - from_mm) / speed, 0)),
            count(area * speed), total(coverage * (to_mm - from_mm)),
            total(iif(coverage IS NULL, 0, to_mm - from_mm)),
            min(area * speed) * 3600e-9, max(area * speed) * 3600e-9
        FROM records WHERE number BETWEEN :low AND :high AND wall_ns >= :since AND wall_ns < :until
        GROUP BY place""",
        {"since": since_ns, "until": until_ns, "width": width_ns, "low": numbers[0], "high": numbers[1]},
    ).fetchall()


def _series(rows: Sequence[Sequence[Any]], start_ns: int, width_ns: int, count: int) -> Series:
    """Return the series of rows (place, ADDED …, flow_low, flow_high)."""
    table = {name: np.zeros(count) for name in ADDED_COLUMNS}
    low, high = np.full(count, np.nan), np.full(count, np.nan)
    if rows:
        places, *columns = zip(*rows, strict=True)
        at = np.array(places)
        for name, values in zip(ADDED_COLUMNS, columns[:-2], strict=True):
            table[name][at] = values
        low[at] = np.array(columns[-2], float)
        high[at] = np.array(columns[-1], float)
    weighed = table["unweighed"] == 0
    stood = (table["known"] > 0) & (table["run_s"] == 0)
    flow = np.where(stood, 0.0, _ratio(table["moved"], table["run_s"]) * 3600e-9)
    mass_flow = np.where(stood, 0.0, _ratio(table["moved_kg"], table["run_s"]) * 3.6)
    return Series(
        start_ns=start_ns + width_ns * np.arange(count, dtype=np.int64),
        width_ns=width_ns,
        records=table["records"].astype(np.int64),
        volume_mm3=table["volume"],
        mass_kg=np.where(weighed, table["mass"], np.nan),
        flow_m3_h=flow,
        flow_low_m3_h=low,
        flow_high_m3_h=high,
        mass_flow_t_h=np.where(weighed, mass_flow, np.nan),
        speed_mm_s=np.where(stood, 0.0, _ratio(table["run_mm"], table["run_s"])),
        coverage=_ratio(table["covered"], table["measured"]),
        valid_mm=table["valid"],
        degraded_mm=table["degraded"],
        missing_mm=table["missing"],
    )


def _ratio(top: Curve, bottom: Curve) -> Curve:
    """Return the quotient; NaN where the divisor is not positive."""
    return np.divide(top, bottom, out=np.full(len(top), np.nan), where=bottom > 0)


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
