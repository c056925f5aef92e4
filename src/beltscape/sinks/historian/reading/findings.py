"""Reading of findings: the checks that there are, and the series of one of them."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.sinks.days import HOUR_NS, compute_day
from beltscape.sinks.historian.storage.finding_files import read_findings
from beltscape.sinks.historian.storage.finding_rows import TEN_MINUTES_NS

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
    """(n,) worst effect, as its place in `core.live.findings.EFFECTS`."""
    faults: NDArray[np.int64]
    """(n,) findings that were faults."""


def list_checks(connection: sqlite3.Connection) -> tuple[CheckKey, ...]:
    """Return all series that have ever been stored, in the order of check and subject."""
    rows = connection.execute("SELECT name, subject, unit FROM checks ORDER BY name, subject, unit")
    return tuple(CheckKey(*row) for row in rows)


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
