"""Reading of a history without a lock and without a trace, also while a running plant writes it."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.reprocessing.comparison.ledger import (
    ComparedLedger,
    LedgerColumns,
    concatenate_columns,
    make_columns,
)
from beltscape.sinks.historian.reading.periods import read_records
from beltscape.sinks.historian.reading.runs import Run, read_runs
from beltscape.sinks.historian.storage.day_files import UNBOUNDED
from beltscape.sinks.historian.storage.schema import MIGRATIONS, open_reader, require_known
from beltscape.sinks.historian.writing.recovery import DATABASE
from beltscape.sinks.historian.writing.sums import Sums, read_sums

HISTORY = "history"
"""Sub-folder of a re-processing's store with its history."""
_PAGE = 20_000
"""Records that are read at once; 20,000 records take some 50 MB as objects. Chosen."""
_TRIES = 3
"""Readings of a database that a starting or ending run changes meanwhile. Chosen."""
_ROUNDING = 1e-9
"""Rounding of a sum of 10⁸ records in double precision, as a share of it: √10⁸ × 1.1e-16 and a margin."""
_DAMAGE = (sqlite3.Error, ValueError, TypeError, IndexError, KeyError, OverflowError)
"""What values of another kind than the tables' raise."""


class ChangedMeanwhileError(Exception):
    """Another process has begun to write the database."""


def read_ledger(folder: Path, reporter: Reporter) -> ComparedLedger:
    """Return the records and runs of the history in ``folder``, or in its sub-folder ``history``.

    Raises
    ------
    InputError
        If there is no history, it has no records, it is damaged, or its tables are of another version.
    """
    path = _find_database(folder)
    for attempt in range(_TRIES):
        try:
            with open_history(path) as connection:
                return _read(folder, path, connection, reporter)
        except ChangedMeanwhileError:
            continue
        except _DAMAGE as error:
            if attempt + 1 < _TRIES and _beside(path, "wal").exists():
                continue  # a run has started while it was read
            reason = " ".join(str(error).split())
            raise InputError(
                f"{path}: cannot be read ({reason}); restore it from a backup, or let a run repair it"
            ) from error
    raise InputError(f"{path}: is started and stopped while it is read; compare again once it runs or rests")


def _find_database(folder: Path) -> Path:
    if not folder.is_dir():
        what = "is no folder" if folder.exists() else "does not exist"
        raise InputError(
            f"{folder}: {what}; give the data folder of a run or replay, or a re-processing's store"
        )
    for path in (folder / DATABASE, folder / HISTORY / DATABASE):
        if path.is_file():
            return path
    raise InputError(
        f"{folder}: has no {DATABASE} and no {HISTORY}/{DATABASE}; give the data folder of a run or replay, "
        "or a re-processing's store"
    )


def _beside(path: Path, ending: str) -> Path:
    """Return the path of a database's log (``wal``) or of the log's index (``shm``)."""
    return path.with_name(f"{path.name}-{ending}")


def _copy(path: Path, folder: Path) -> Path:
    for source in (path, _beside(path, "wal")):
        copyfile(source, folder / source.name)
    return folder / path.name


@contextmanager
def open_history(path: Path) -> Generator[sqlite3.Connection]:
    """Yield a connection with one consistent view.

    A database that nobody has open has no log; it is opened as immutable, because a usual reader would leave an empty
    log behind. A database with a log is read beside its writer, as a backup reads it. A log without an index has no
    writer (it was copied so); then a copy of both is read.
    """
    if _beside(path, "wal").exists():
        with TemporaryDirectory() as folder:
            read = path if _beside(path, "shm").exists() else _copy(path, Path(folder))
            with closing(open_reader(read)) as connection:
                connection.execute("BEGIN")
                yield connection
        return
    before = path.stat()
    address = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    with closing(sqlite3.connect(address, uri=True, isolation_level=None)) as connection:
        yield connection
    after = path.stat()
    if _beside(path, "wal").exists() or (before.st_mtime_ns, before.st_size) != (
        after.st_mtime_ns,
        after.st_size,
    ):
        raise ChangedMeanwhileError


def _read(folder: Path, path: Path, connection: sqlite3.Connection, reporter: Reporter) -> ComparedLedger:
    _require_present_version(connection, path)
    _require_sound(connection, path)
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


def _require_sound(connection: sqlite3.Connection, path: Path) -> None:
    """Raise InputError if SQLite finds damage in the structure of the file."""
    (answer,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if answer != "ok":
        raise InputError(
            f"{path}: is damaged ({' '.join(answer.split())}); restore it from a backup, or let a run repair it"
        )


def _check_sums(columns: LedgerColumns, sums: Sums | None, path: Path, reporter: Reporter) -> None:
    """Warn if the records do not add up to the sums that the ledger keeps with a checksum."""
    volumes = columns.volume_mm3[columns.is_counted]
    kept = math.nan if sums is None else sums.totals.volume_mm3
    if not abs(float(volumes.sum()) - kept) <= _ROUNDING * float(np.abs(volumes).sum()):
        reporter.warn(
            f"{path}: its records add up to {volumes.sum() * 1e-9:.6g} m³, its totals are {kept * 1e-9:.6g} m³: they "
            "were changed or are damaged; restore it from a backup"
        )


def _require_present_version(connection: sqlite3.Connection, path: Path) -> None:
    version = require_known(connection, path)
    if version == 0:
        raise InputError(f"{path}: has no tables of a history; give the data folder of a run or replay")
    if version < len(MIGRATIONS):
        raise InputError(
            f"{path}: its tables are of version {version}, this program reads {len(MIGRATIONS)}; a run of this "
            "program updates them: start it once, or compare a copy that it has updated"
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
