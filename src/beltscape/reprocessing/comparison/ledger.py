"""The records of a history as columns, and the runs that wrote them.

A history is read without a lock and without a trace, also while a running plant writes it.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from sys import intern
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.core.ledger import QUALITIES, STANDINGS, BeltRecord
from beltscape.core.progress import Reporter
from beltscape.sinks.historian.day_files import UNBOUNDED
from beltscape.sinks.historian.events import Run, read_runs
from beltscape.sinks.historian.ledger import LedgerTotals, read_sums
from beltscape.sinks.historian.periods import read_records
from beltscape.sinks.historian.reading import find_database, read_history, require_sound

Numbers = NDArray[np.float64]
Codes = NDArray[np.int64]
Texts = NDArray[Any]
"""Texts as Python objects: in arrays of fixed width one long reason would widen all others."""

NO_TIME = np.iinfo(np.int64).min
"""Stands for a time that is not known: the least 64-bit integer, which no clock gives."""
MISSING = STANDINGS.index("missing")
"""Code of the standing of belt that was not measured: its place in `STANDINGS`."""
_MEASURED = ("belt_position_mm", "area_mm2", "volume_mm3", "sigma_mm3", "common_sigma_mm3", "speed_mm_s",
             "density_kg_m3", "density_sigma_kg_m3", "coverage", "single_coverage")  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class LedgerColumns:
    """n records in the ledger's order, a column per quantity; NaN: not known, or a record without a strip."""

    number: Codes
    """(n,) record numbers, ascending."""
    run: Codes
    """(n,) numbers of the runs that wrote them."""
    from_mm: Numbers
    to_mm: Numbers
    """(n,) beginning and end of each stretch by the ledger's count, ascending."""
    standing: Codes
    """(n,) place in `STANDINGS`."""
    reason: Texts
    """(n,) why a record is not valid; empty where it is."""
    product: Texts
    """(n,) product names."""
    frame: Texts
    """(n,) names of the frames; empty without a strip."""
    time_ns: Codes
    """(n,) trigger times; `NO_TIME`: not known."""
    quality: Codes
    """(n,) place in `QUALITIES`; -1 without a strip."""
    cameras: Codes
    """(n,) cameras with an image."""
    batch: Codes
    """(n,) batch numbers."""
    run_sigma_mm3: Numbers
    offset_mm: Numbers
    """(n,) the ledger's count minus the encoder's."""
    strip_from_mm: Numbers
    strip_to_mm: Numbers
    """(n,) the strip in the meter's own belt coordinate."""
    belt_position_mm: Numbers
    area_mm2: Numbers
    volume_mm3: Numbers
    sigma_mm3: Numbers
    common_sigma_mm3: Numbers
    speed_mm_s: Numbers
    density_kg_m3: Numbers
    density_sigma_kg_m3: Numbers
    coverage: Numbers
    single_coverage: Numbers
    """(n,) as in `FlowRecord`."""

    def __len__(self) -> int:
        return len(self.number)

    @property
    def length_mm(self) -> Numbers:
        """Return the length of each stretch."""
        return self.to_mm - self.from_mm

    @property
    def is_counted(self) -> NDArray[np.bool_]:
        """Return which records have a volume that the totals count."""
        return (self.standing != MISSING) & np.isfinite(self.volume_mm3)


@dataclass(frozen=True, slots=True, eq=False)
class ComparedLedger:
    """One side of a comparison."""

    folder: Path
    """The folder as the user named it."""
    columns: LedgerColumns
    runs: Mapping[int, Run]
    """Runs by number; a run without an entry has no known provenance."""


def make_columns(records: Iterable[BeltRecord]) -> LedgerColumns:
    """Return the columns of records in the ledger's order."""
    listed = list(records)
    strips = [record.strip for record in listed]

    def measured(name: str) -> Numbers:
        return _numbers([math.nan if strip is None else getattr(strip, name) for strip in strips])

    return LedgerColumns(
        number=_codes([record.number for record in listed]),
        run=_codes([record.run for record in listed]),
        from_mm=_numbers([record.belt_mm[0] for record in listed]),
        to_mm=_numbers([record.belt_mm[1] for record in listed]),
        standing=_codes([STANDINGS.index(record.standing) for record in listed]),
        reason=_texts([record.reason for record in listed]),
        product=_texts([record.product for record in listed]),
        frame=_texts(["" if strip is None else strip.frame for strip in strips]),
        time_ns=_codes(
            [NO_TIME if strip is None or strip.time_ns is None else strip.time_ns for strip in strips]
        ),
        quality=_codes([-1 if strip is None else QUALITIES.index(strip.quality) for strip in strips]),
        cameras=_codes([record.cameras for record in listed]),
        batch=_codes([record.batch for record in listed]),
        run_sigma_mm3=_numbers([record.run_sigma_mm3 for record in listed]),
        offset_mm=_numbers([record.offset_mm for record in listed]),
        strip_from_mm=_numbers([math.nan if strip is None else strip.strip_mm[0] for strip in strips]),
        strip_to_mm=_numbers([math.nan if strip is None else strip.strip_mm[1] for strip in strips]),
        **{name: measured(name) for name in _MEASURED},
    )


def concatenate_columns(parts: Sequence[LedgerColumns]) -> LedgerColumns:
    """Return the columns of all parts, one after the other."""
    names = LedgerColumns.__dataclass_fields__
    return LedgerColumns(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _numbers(values: Sequence[float]) -> Numbers:
    return np.array(values, np.float64)


def _codes(values: Sequence[int]) -> Codes:
    return np.array(values, np.int64)


def _texts(values: Sequence[str]) -> Texts:
    return np.array([intern(value) for value in values], object)


_PAGE = 20_000
"""Records that are read at once; 20,000 records take some 50 MB as objects. Chosen."""
_ROUNDING = 1e-9
"""Rounding of a sum of 10⁸ records in double precision, as a share of it: √10⁸ × 1.1e-16 and a margin."""


def read_ledger(folder: Path, reporter: Reporter) -> ComparedLedger:
    """Return the records and runs of the history in ``folder``, or in its sub-folder ``history``.

    Raises
    ------
    InputError
        If there is no history, it has no records, it is damaged, or its tables are of another version.
    """
    path = find_database(folder)
    return read_history(path, lambda connection: _read(folder, path, connection, reporter))


def _read(folder: Path, path: Path, connection: sqlite3.Connection, reporter: Reporter) -> ComparedLedger:
    require_sound(connection, path)
    shift_ns, number, state = connection.execute(
        "SELECT coalesce(shift_ns, 0), number, state FROM ledger"
    ).fetchone()
    runs: dict[int, Run] = {run.number: run for run in read_runs(connection, UNBOUNDED)}
    parts: list[LedgerColumns] = []
    for part in _read_pages(connection, path.parent / "days", shift_ns):
        parts.append(part)
        reporter.step(f"reading {folder}", min(int(part.number[-1]), number), number)
    if not parts:
        raise InputError(f"{path}: has no records; there is nothing to compare")
    columns = concatenate_columns(parts)
    _require_order(columns, path)
    if missing := number - len(columns):
        reporter.warn(f"{path}: {missing} records are no longer there; their belt is not compared")
    else:
        _check_sums(columns, read_sums(state), path, reporter)
    return ComparedLedger(folder, columns, runs)


def _check_sums(columns: LedgerColumns, sums: LedgerTotals | None, path: Path, reporter: Reporter) -> None:
    """Warn if the records do not add up to the sums that the ledger keeps with a checksum."""
    volumes = columns.volume_mm3[columns.is_counted]
    kept = math.nan if sums is None else sums.totals.volume_mm3
    if not abs(float(volumes.sum()) - kept) <= _ROUNDING * float(np.abs(volumes).sum()):
        reporter.warn(
            f"{path}: its records add up to {volumes.sum() * 1e-9:.6g} m³, its totals are {kept * 1e-9:.6g} m³: they "
            "were changed or are damaged; restore it from a backup"
        )


def _read_pages(connection: sqlite3.Connection, days: Path, shift_ns: int) -> Iterator[LedgerColumns]:
    after = 0
    while True:
        records = read_records(
            connection, days, (-UNBOUNDED, UNBOUNDED), after, _PAGE, shift_ns, sections=False
        )
        if not records:
            return
        yield make_columns(records)
        after = records[-1].number


def _require_order(columns: LedgerColumns, path: Path) -> None:
    """Raise InputError unless the stretches follow each other along the belt."""
    edges = np.stack([columns.from_mm, columns.to_mm], axis=1).ravel()
    backwards = ~(np.diff(edges) >= 0)
    if not np.isfinite(edges).all() or backwards.any():
        at = int(np.argmax(backwards)) // 2
        raise InputError(
            f"{path}: record {columns.number[at]} is not followed by later belt; restore it from a backup"
        )
