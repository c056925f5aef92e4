"""Findings in the history: appended with their sums over ten minutes, and read as the series of a check.

Rows of the database have NULL for NaN. Closed days are Parquet files, ``findings/2026-11-21.parquet``, with a row
group for each check and subject.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError, OutputError
from beltscape.core.findings import EFFECTS, Finding
from beltscape.files.atomic import commit_file
from beltscape.sinks.days import HOUR_NS, compute_day
from beltscape.sinks.historian.ledger import transaction

if TYPE_CHECKING:
    import pyarrow as pa


TEN_MINUTES_NS = 600_000_000_000
"""Width of the intervals of the sums."""
MAX_TEXT = 500
"""Longer texts are cut; the messages of the checks have up to 300 characters."""


@dataclass(frozen=True, slots=True)
class StoredFinding:
    """A finding and its time."""

    wall_ns: int
    """System clock, ns since 1970."""
    finding: Finding


def to_finding_row(stored: StoredFinding) -> tuple[int, float | None, float | None, float | None, int, str]:
    """Return time, value, σ, limit, effect and text as the table ``findings`` has them."""
    finding = stored.finding
    return (
        int(stored.wall_ns),
        to_null(finding.value),
        to_null(finding.sigma),
        to_null(finding.limit),
        EFFECTS.index(finding.effect),
        finding.text[:MAX_TEXT],
    )


def to_null(value: float) -> float | None:
    """Return the value; None where it is not finite."""
    return float(value) if math.isfinite(value) else None


_INSERT = (
    "INSERT INTO findings (series, wall_ns, value, sigma, bound, effect, text) VALUES (?, ?, ?, ?, ?, ?, ?)"
)
_ADD = """
    INSERT INTO finding_sums VALUES (:series, :bucket, :count, coalesce(:value, 0), :value, :value,
        coalesce(:sigma, 0), :sigma IS NOT NULL, :bound, :effect, :faults)
    ON CONFLICT (series, bucket) DO UPDATE SET
        count = count + excluded.count, total = total + excluded.total,
        low = min(coalesce(low, excluded.low), coalesce(excluded.low, low)),
        high = max(coalesce(high, excluded.high), coalesce(excluded.high, high)),
        sigma = sigma + excluded.sigma, sigmas = sigmas + excluded.sigmas,
        bound = max(coalesce(bound, excluded.bound), coalesce(excluded.bound, bound)),
        effect = max(effect, excluded.effect), faults = faults + excluded.faults"""


def append_findings(connection: sqlite3.Connection, findings: Sequence[StoredFinding]) -> None:
    """Store all or none of the findings. They are on disk when this returns; sqlite3.Error otherwise."""
    with transaction(connection):
        for stored in findings:
            series = _find_series(connection, stored)
            row = to_finding_row(stored)
            wall_ns, value, sigma, bound, effect, text = row
            connection.execute(_INSERT, (series, *row))
            connection.execute(
                _ADD,
                {
                    "series": series,
                    "bucket": wall_ns // TEN_MINUTES_NS,
                    "count": int(value is not None),
                    "value": value,
                    "sigma": sigma,
                    "bound": bound,
                    "effect": effect,
                    "faults": int(bool(text)),
                },
            )


def _find_series(connection: sqlite3.Connection, stored: StoredFinding) -> int:
    """Return the number of the finding's series, which is created where it is new."""
    key = (stored.finding.check, stored.finding.subject, stored.finding.unit)
    find = "SELECT series FROM checks WHERE name = ? AND subject = ? AND unit = ?"
    found = connection.execute(find, key).fetchone()
    if found is None:
        connection.execute("INSERT INTO checks (name, subject, unit) VALUES (?, ?, ?)", key)
        found = connection.execute(find, key).fetchone()
    return found[0]


FindingRow = Sequence[Any]
"""Check, subject, unit, wall_ns, value, σ, limit, index of the effect, text."""
_FORMAT = b"beltscape-findings/1"
_DAY = b"beltscape-day"
_NUMBERS = ("value", "sigma", "limit")
_NAMES = ("check", "subject", "unit", "wall_time", *_NUMBERS, "effect", "text")


def _make_schema() -> pa.Schema:
    import pyarrow as pa

    kinds = {"wall_time": pa.timestamp("ns", tz="UTC"), **dict.fromkeys(_NUMBERS, pa.float64())}
    return pa.schema([pa.field(name, kinds.get(name, pa.string())) for name in _NAMES])


def write_finding_day(path: Path, day: int, series: Iterable[Sequence[FindingRow]]) -> int:
    """Write the rows of a day, a row group for each series, and return the file's size.

    Raises
    ------
    OutputError
        When it cannot be written, or has another number of rows when read back.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    temporary = path.with_name(f".{path.name}.part")
    schema, count = _make_schema(), 0
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
            for rows in series:
                columns = [list(column) for column in zip(*rows, strict=True)]
                columns[7] = [EFFECTS[effect] for effect in columns[7]]
                table = pa.table(dict(zip(_NAMES, columns, strict=True)), schema=schema)
                writer.write_table(table, row_group_size=len(rows))
                count += len(rows)
            writer.add_key_value_metadata({b"beltscape": _FORMAT, _DAY: str(day).encode()})
        with pq.ParquetFile(temporary) as file:
            if file.metadata.num_rows != count:
                raise OSError("it does not read back as it was written")
        commit_file(temporary, path)
    except (OSError, pa.ArrowException) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise OutputError(
            f"{path}: cannot be written ({reason}); its findings stay in the database"
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    return path.stat().st_size


def read_finding_day(path: Path) -> int:
    """Return the day of a file, days since 1970; InputError if it is no day file of findings."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            about = file.metadata.metadata or {}
        if about.get(b"beltscape") == _FORMAT:
            return int(about[_DAY])
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise InputError(f"{path}: not a readable file of findings; restore it from a backup") from error
    raise InputError(f"{path}: not a file of findings; move it away")


def read_findings(path: Path, check: str, subject: str, times_ns: tuple[int, int]) -> list[FindingRow]:
    """Return the rows of one series in a period (its end excluded); InputError if the file is damaged."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows: list[FindingRow] = []
    try:
        with pq.ParquetFile(path) as file:
            for place in range(file.num_row_groups):
                first = file.metadata.row_group(place).column(0).statistics
                if first is None or first.min <= check <= first.max:
                    rows += _list_rows(file.read_row_group(place))
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise InputError(f"{path}: not a readable file of findings; restore it from a backup") from error
    return [row for row in rows if row[:2] == (check, subject) and times_ns[0] <= row[3] < times_ns[1]]


def _list_rows(table: pa.Table) -> list[FindingRow]:
    import pyarrow as pa

    columns: dict[str, list[Any]] = {}
    for name in _NAMES:
        column = table[name].cast(pa.int64()) if name == "wall_time" else table[name]
        columns[name] = list(column.to_pylist())
    columns["effect"] = [EFFECTS.index(name) for name in columns["effect"]]
    return list(zip(*columns.values(), strict=True))


_RAW_NS = 48 * HOUR_NS
"""A shorter period is computed from the findings themselves, a longer one from the sums over ten minutes."""
Curve = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CheckKey:
    """One series of findings."""

    check: str
    """Name of the check."""
    subject: str
    """Camera; empty: the whole system."""
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class FindingSeries:
    """The findings of one check over n equal intervals; NaN: not measured in it."""

    start_ns: NDArray[np.int64]
    """(n,) system clock at which each interval begins, ns since 1970."""
    width_ns: int
    """Length of each interval."""
    mean: Curve
    """(n,) mean value."""
    low: Curve
    """(n,) least value."""
    high: Curve
    """(n,) greatest value."""
    sigma: Curve
    """(n,) mean σ."""
    limit: Curve
    """(n,) greatest limit."""
    effect: NDArray[np.int64]
    """(n,) worst effect, as its place in `core.findings.EFFECTS`."""
    faults: NDArray[np.int64]
    """(n,) findings that were faults."""


def list_checks(connection: sqlite3.Connection) -> tuple[CheckKey, ...]:
    """Return all series that have ever been stored, in the order of check and subject."""
    rows = connection.execute("SELECT name, subject, unit FROM checks ORDER BY name, subject, unit")
    return tuple(CheckKey(*row) for row in rows)


def average_findings(
    connection: sqlite3.Connection, check: str, since_ns: int, until_ns: int
) -> tuple[float, float] | None:
    """Return mean value and mean σ of a check in the ten minutes of a period that have no fault; None without any."""
    count, total, sigma, sigmas = connection.execute(
        "SELECT total(count), total(finding_sums.total), total(sigma), total(sigmas) FROM finding_sums "
        "JOIN checks USING (series) WHERE checks.name = ? AND bucket >= ? AND bucket <= ? AND effect = 0",
        (check, since_ns // TEN_MINUTES_NS, until_ns // TEN_MINUTES_NS),
    ).fetchone()
    return (total / count, sigma / sigmas if sigmas else 0.0) if count else None


def read_finding_series(
    connection: sqlite3.Connection,
    folder: Path,
    key: tuple[str, str],
    times_ns: tuple[int, int],
    points: int,
    shift_ns: int,
) -> FindingSeries:
    """Return a series (``key``: check, subject) in a period, its end excluded, in at most ``points`` intervals."""
    since, until = times_ns
    span = max(1, until - since)
    if span <= _RAW_NS:
        width = math.ceil(span / points)
        rows = [
            *_read_database(connection, key, times_ns),
            *_read_files(connection, folder, key, times_ns, shift_ns),
        ]
        return _bin(((row, 1) for row in rows), since, width, math.ceil(span / width))
    first, last = since // TEN_MINUTES_NS, -(-until // TEN_MINUTES_NS)
    times = max(1, math.ceil((last - first) / points))
    sums = connection.execute(
        "SELECT bucket, total / nullif(count, 0), low, high, sigma / nullif(sigmas, 0), bound, effect, faults, count "
        "FROM checks JOIN finding_sums USING (series) WHERE name = ? AND subject = ? AND bucket >= ? AND bucket < ?",
        (*key, first, last),
    )
    spread = (
        ((bucket * TEN_MINUTES_NS, mean, low, high, sigma, bound, effect, faults), count)
        for bucket, mean, low, high, sigma, bound, effect, faults, count in sums
    )
    count = max(1, math.ceil((last - first) / times))
    return _bin(spread, first * TEN_MINUTES_NS, times * TEN_MINUTES_NS, count)


def _read_database(
    connection: sqlite3.Connection, key: tuple[str, str], times_ns: tuple[int, int]
) -> list[tuple[Any, ...]]:
    rows = connection.execute(
        "SELECT wall_ns, value, sigma, bound, effect, text <> '' FROM checks JOIN findings USING (series) "
        "WHERE name = ? AND subject = ? AND wall_ns >= ? AND wall_ns < ?",
        (*key, *times_ns),
    )
    return [_spread(*row) for row in rows]


def _read_files(
    connection: sqlite3.Connection,
    folder: Path,
    key: tuple[str, str],
    times_ns: tuple[int, int],
    shift_ns: int,
) -> list[tuple[Any, ...]]:
    """Return the findings that are no longer in the database; a file that was removed has none."""
    days = [compute_day(ns, shift_ns) for ns in (times_ns[0], times_ns[1] - 1)]
    names = connection.execute(
        "SELECT name FROM finding_files WHERE pruned AND day BETWEEN ? AND ? ORDER BY day", days
    ).fetchall()
    return [
        _spread(row[3], row[4], row[5], row[6], row[7], bool(row[8]))
        for (name,) in names
        if (folder / name).exists()
        for row in read_findings(folder / name, *key, times_ns)
    ]


def _spread(
    wall_ns: int,
    value: float | None,
    sigma: float | None,
    bound: float | None,
    effect: int,
    fault: bool,
) -> tuple[Any, ...]:
    """Return the row of an interval that has this finding only."""
    return wall_ns, value, value, value, sigma, bound, effect, int(fault)


def _bin(
    rows: Iterable[tuple[Sequence[Any], int]], start_ns: int, width_ns: int, count: int
) -> FindingSeries:
    """Return the series of rows (time, mean, low, high, σ, limit, effect, faults), each with its weight."""
    listed = list(rows)
    start = start_ns + width_ns * np.arange(count, dtype=np.int64)
    nothing = np.full(count, np.nan)
    zeros = np.zeros(count, np.int64)
    if not listed:
        return FindingSeries(start, width_ns, nothing, nothing, nothing, nothing, nothing, zeros, zeros)
    place = (np.array([row[0] for row, _ in listed], np.int64) - start_ns) // width_ns
    weight = np.array([max(each, 1) for _, each in listed], float)
    mean, low, high, sigma, bound = (
        np.array([row[column] for row, _ in listed], float) for column in range(1, 6)
    )
    effect, faults = zeros.copy(), zeros.copy()
    np.maximum.at(effect, place, np.array([row[6] for row, _ in listed]))
    np.add.at(faults, place, np.array([row[7] for row, _ in listed]))
    return FindingSeries(
        start_ns=start,
        width_ns=width_ns,
        mean=_average(place, mean, weight, count),
        low=_reduce(np.fmin, place, low, count),
        high=_reduce(np.fmax, place, high, count),
        sigma=_average(place, sigma, weight, count),
        limit=_reduce(np.fmax, place, bound, count),
        effect=effect,
        faults=faults,
    )


def _average(place: NDArray[np.int64], values: Curve, weight: Curve, count: int) -> Curve:
    known = np.isfinite(values)
    total = np.bincount(place[known], weight[known], count)
    sums = np.bincount(place[known], (values * weight)[known], count)
    return np.divide(sums, total, out=np.full(count, np.nan), where=total > 0)


def _reduce(least_or_greatest: np.ufunc, place: NDArray[np.int64], values: Curve, count: int) -> Curve:
    out = np.full(count, np.nan)
    least_or_greatest.at(out, place, values)
    return out
