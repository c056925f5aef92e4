"""Recovery of a damaged database: it is moved aside, and a new one continues with the newest readable totals.

The totals are searched in the bytes of the damaged file (they are stored as text with a checksum), in the snapshot
``totals.json`` beside it, and in the memory of the running program. Day files and the tables in csv/ give the
ledger's end and totals where they reach further: a database that was emptied or replaced by an older one, without a
readable ``totals.json``, would otherwise begin again with numbers and belt positions that were given out before.

A database that another program deleted, replaced, cut or changed while it was open is rescued: the open connection
still reads the file that it opened, even without a name; a copy of it takes the name again.
"""

from __future__ import annotations

import mmap
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from beltscape.core.errors import InputError, OutputError
from beltscape.core.ledger import BeltRecord
from beltscape.files.atomic import DAMAGED, commit_file, describe_refusal, move_aside, write_durably
from beltscape.files.sqlite_failures import describe_failure, is_damage, is_temporary
from beltscape.sinks.csv_sink import PATTERN, read_last_number, read_records
from beltscape.sinks.historian.database import locate_suspect_marker, open_writer
from beltscape.sinks.historian.day_files import UNBOUNDED, DayFile, read_day, read_summary
from beltscape.sinks.historian.ledger import (
    SUMS_BEGIN,
    LedgerTotals,
    append_records,
    read_leading_sums,
    read_sums,
    set_sums,
    transaction,
)
from beltscape.sinks.historian.production import salvage_production

_BATCH = 5_000
"""Records of a table that are stored in one transaction, which others wait for. Chosen."""
_SAME_MM = 1e-3
"""Tables round positions to 1e-4 mm; a difference up to this is no gap."""
_UNKNOWN_SIGMA = 1.0
"""Relative σ of a table's volumes where no record shows how well this plant is measured: nothing is claimed."""
_SIGMA_FACTOR = 2.0
"""Tables have no σ: theirs is this multiple of the relative σ of the other records, a margin without measurement."""


@dataclass(frozen=True, slots=True)
class CaughtUp:
    """The sums after the recovery."""

    sums: LedgerTotals
    message: str
    """Line that describes what was recovered and what is missing; empty if nothing was."""


class _CatchUp:
    """Adds the records that files have behind the database's end."""

    def __init__(self, connection: sqlite3.Connection, sums: LedgerTotals) -> None:
        self.connection, self.sums = connection, sums
        self.lost: list[str] = []
        self._volume, self._sigma = connection.execute(
            "SELECT total(volume), total(sigma) FROM records WHERE volume > 0"
        ).fetchone()

    def add_day_files(self, days: Path) -> int:
        """Add the records of unregistered day files to the sums; return how many there were."""
        registered = {row[0] for row in self.connection.execute("SELECT name FROM files")}
        files = [
            (summary.first, path)
            for path in _list_files(days, "*.parquet")
            if path.name not in registered and (summary := _read_summary(path)) is not None
            if summary.last > self.sums.number
        ]
        begin = self.sums.number
        for _, path in sorted(files):
            try:
                records = read_day(path, (self.sums.number + 1, UNBOUNDED), sections=False)
            except InputError:
                continue  # damaged: its records are counted as lost when the next ones follow
            for record in records:
                self._skip_to(record)
                self.sums = self.sums.add_record(record)
                self._volume += record.volume_mm3
                self._sigma += record.sigma_mm3
        if self.sums.number > begin:
            with transaction(self.connection):
                set_sums(self.connection, self.sums)
        return self.sums.number - begin

    def add_tables(self, folder: Path, shift_ns: int) -> int:
        """Store the records of CSV files behind the end of the sums; return how many there were."""
        ends = sorted((read_last_number(path), path) for path in _list_files(folder, PATTERN))
        begin, sigma = self.sums.number, _UNKNOWN_SIGMA
        if self._volume > 0:
            known = max(self._sigma / self._volume, self._relative_sigma_of_totals())
            sigma = min(_UNKNOWN_SIGMA, _SIGMA_FACTOR * known)
        for last, path in ends:
            if last > self.sums.number:
                rows = read_records(path, self.sums.number, sigma)
                while batch := list(islice(rows, _BATCH)):
                    self._store(batch, shift_ns)
        return self.sums.number - begin

    def _relative_sigma_of_totals(self) -> float:
        totals = self.sums.totals
        return totals.sigma_mm3 / totals.volume_mm3 if totals.volume_mm3 > 0 else 0.0

    def _store(self, records: list[BeltRecord], shift_ns: int) -> None:
        for group in _contiguous(records):
            if self._skip_to(group[0]):
                with transaction(self.connection):
                    set_sums(self.connection, self.sums)
            joined = list(self._join(group))
            self.sums = append_records(self.connection, self.sums, joined, shift_ns, sections=False)

    def _join(self, records: list[BeltRecord]) -> Iterator[BeltRecord]:
        """Yield the records with exact positions and with the σ of their run, added up without cancellation."""
        end_mm, run, sigma = self.sums.end_mm, self.sums.run, self.sums.sigma_run_mm3
        for record in records:
            start = record.belt_mm[0] if end_mm is None else end_mm
            end_mm = max(start, record.belt_mm[1])
            sigma = (sigma if record.run == run else 0.0) + record.sigma_mm3
            run = record.run
            yield replace(record, belt_mm=(start, end_mm), run_sigma_mm3=sigma, offset_mm=self.sums.offset_mm)

    def _skip_to(self, record: BeltRecord) -> bool:
        """Move the end of the sums to right before a record; return whether records or belt are missing between."""
        sums = self.sums
        if record.number == sums.number + 1 and (
            sums.end_mm is None or abs(record.belt_mm[0] - sums.end_mm) <= _SAME_MM
        ):
            return False
        if record.number > sums.number + 1:
            self.lost.append(f"{sums.number + 1} to {record.number - 1}")
        self.sums = replace(sums, number=record.number - 1, end_mm=None)
        return True


def catch_up(connection: sqlite3.Connection, sums: LedgerTotals, folder: Path, shift_ns: int) -> CaughtUp:
    """Return the sums with everything that day files and tables have behind the database's end.

    Raises
    ------
    sqlite3.Error
        When the database cannot be written.
    """
    work = _CatchUp(connection, sums)
    try:
        filed = work.add_day_files(folder / "days")
        tabled = work.add_tables(folder / "csv", shift_ns)
    except OSError as error:
        raise InputError(
            f"{error.filename or folder}: cannot be read ({error.strerror or error}); the history's end is checked "
            "against it; correct its permissions"
        ) from error
    if work.sums.number == sums.number:
        return CaughtUp(sums, "")
    lost = f"; records {', '.join(work.lost)} are in no file, the totals lack them" if work.lost else ""
    message = (
        f"{folder}: the database ended with record {sums.number}, the files with {work.sums.number}: it was emptied, "
        f"deleted or is an older copy; number, end and totals continue from {filed} records of days/ and {tabled} of "
        f"csv/{lost}"
    )
    return CaughtUp(work.sums, message)


def _list_files(folder: Path, pattern: str) -> list[Path]:
    """Return the matching files; OSError if the folder cannot be listed, unlike ``Path.glob``."""
    return [path for path in folder.iterdir() if path.match(pattern)] if folder.is_dir() else []


def _read_summary(path: Path) -> DayFile | None:
    try:
        return read_summary(path)
    except (InputError, FileNotFoundError):
        return None


def _contiguous(records: list[BeltRecord]) -> Iterator[list[BeltRecord]]:
    """Yield the records in groups without a gap of numbers or belt."""
    group: list[BeltRecord] = []
    for record in records:
        if group and (
            record.number != group[-1].number + 1 or abs(record.belt_mm[0] - group[-1].belt_mm[1]) > _SAME_MM
        ):
            yield group
            group = []
        group.append(record)
    if group:
        yield group


DATABASE = "history.db"
SNAPSHOT = "totals.json"
_QUICK_BYTES = 256 << 20
"""A database up to this size is checked page by page at every start, a larger one only where it is read. Chosen."""
_TEXT_BYTES = 4096
"""The text of the sums is shorter than a page."""


@dataclass(frozen=True, slots=True)
class OpenedDatabase:
    """A sound database."""

    connection: sqlite3.Connection
    sums: LedgerTotals
    number: int
    """The database holds all records up to this number, and perhaps later ones behind those of unknown day files."""
    message: str
    """Line that describes the repair; empty without a repair."""


def open_or_recover(folder: Path, shift_ns: int) -> OpenedDatabase:
    """Open the history in ``folder``; replace a damaged or missing database by a new one with the old totals.

    Where day files or tables in csv/ reach further than the database, the ledger continues behind them.

    Raises
    ------
    InputError
        When the database is a newer version's or another program's.
    OutputError
        When it cannot be moved aside.
    sqlite3.OperationalError
        When it cannot be written.
    """
    opened = _open_or_replace(folder, shift_ns)
    try:
        caught_up = catch_up(opened.connection, opened.sums, folder, shift_ns)
    except BaseException:
        opened.connection.close()
        raise
    messages = [text for text in (opened.message, caught_up.message) if text]
    return OpenedDatabase(opened.connection, caught_up.sums, opened.number, "; ".join(messages))


def _open_or_replace(folder: Path, shift_ns: int) -> OpenedDatabase:
    path = folder / DATABASE
    saved = read_snapshot(folder)
    try:
        connection = open_writer(path)
    except sqlite3.Error as error:
        if not is_damage(error):
            raise
        return replace_database(folder, shift_ns, saved, str(error))
    try:
        sums = _check_database(connection, path)
    except sqlite3.Error as error:
        connection.close()
        if not is_damage(error):
            raise
        return replace_database(folder, shift_ns, saved, str(error))
    if saved is None or saved.number <= sums.number:
        return OpenedDatabase(connection, sums, sums.number, "")
    with transaction(connection):
        set_sums(connection, saved)
    message = (
        f"{path}: it ends with record {sums.number}, {SNAPSHOT} with {saved.number}: it is an older copy, or it "
        "was deleted; the newer totals are used, the records between are missing"
    )
    return OpenedDatabase(connection, saved, sums.number, message)


def replace_database(folder: Path, shift_ns: int, known: LedgerTotals | None, why: str) -> OpenedDatabase:
    """Move the database aside and create a new one with the newest totals; no connection may be open."""
    path = folder / DATABASE
    moved = move_database_aside(path)
    locate_suspect_marker(path).unlink(missing_ok=True)
    candidates = [sums for sums in (known, read_snapshot(folder), _salvage_sums(moved)) if sums is not None]
    sums = max(candidates, key=lambda each: each.number, default=LedgerTotals())
    connection = open_writer(path)
    with transaction(connection):
        set_sums(connection, sums)
        connection.execute("UPDATE ledger SET shift_ns = ?", (shift_ns,))
        salvage_production(moved, connection)
    message = (
        f"{path}: it was damaged ({why}) and was moved to {moved.parent}; a new one continues after record "
        f"{sums.number} with the same totals, older records are in the day files"
    )
    return OpenedDatabase(connection, sums, 0, message)


def read_snapshot(folder: Path) -> LedgerTotals | None:
    """Return the totals of ``totals.json``; None if it is absent or damaged."""
    try:
        return read_sums((folder / SNAPSHOT).read_text("utf-8"))
    except (OSError, UnicodeDecodeError):
        return None


def write_snapshot(folder: Path, sums: LedgerTotals) -> None:
    """Write the totals beside the database, for its recovery; OSError if that fails."""
    write_durably(folder / SNAPSHOT, (sums.text() + "\n").encode())


def _check_database(connection: sqlite3.Connection, path: Path) -> LedgerTotals:
    """Check the database and return its sums; sqlite3.DatabaseError if it is damaged."""
    number, state = connection.execute("SELECT number, state FROM ledger").fetchone() or (0, "gone")
    sums = LedgerTotals() if not state and not number else read_sums(state)
    if sums is None or sums.number != number:
        raise sqlite3.DatabaseError("the end of its ledger is not readable")
    if path.stat().st_size <= _QUICK_BYTES or locate_suspect_marker(path).exists():
        result = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        if result != "ok":
            raise sqlite3.DatabaseError(" ".join(result.split()))
        locate_suspect_marker(path).unlink(missing_ok=True)
    last = connection.execute("SELECT max(number) FROM records").fetchone()[0]
    if last is not None and last > number:
        raise sqlite3.DatabaseError(f"it holds record {last} behind the end of its ledger")
    return sums


def move_database_aside(path: Path) -> Path:
    """Move a database with its log to a new folder in damaged/; return its path there. OutputError if impossible."""
    try:
        return move_aside(path, ("-wal", "-shm"))
    except OSError as error:
        raise OutputError(
            f"{path}: it is damaged and cannot be moved to {path.parent / DAMAGED} ({error.strerror or error}); move "
            "it away by hand"
        ) from error


def _salvage_sums(path: Path) -> LedgerTotals | None:
    """Return the newest sums with a valid checksum anywhere in the bytes of a database or its log."""
    found: list[LedgerTotals] = []
    for file in (path, path.with_name(f"{path.name}-wal")):
        try:
            with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                texts = (
                    data[place.start() : place.start() + _TEXT_BYTES] for place in SUMS_BEGIN.finditer(data)
                )
                found.extend(sums for sums in map(read_leading_sums, texts) if sums is not None)
        except (OSError, ValueError):
            continue  # absent or empty
    return max(found, key=lambda sums: sums.number, default=None)


def rescue_database(
    folder: Path, shift_ns: int, connection: sqlite3.Connection, sums: LedgerTotals, why: str
) -> OpenedDatabase:
    """Write the database again from the open connection, which is closed; from the totals alone if it is unsound.

    Raises
    ------
    OutputError
        When the folder cannot be written.
    """
    path = folder / DATABASE
    copy = folder / f".{DATABASE}.rescued"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        copy.unlink(missing_ok=True)
        correct_end(connection, sums)
        with closing(sqlite3.connect(copy)) as target:
            connection.backup(target)
            _require_sound(target)
            target.execute("PRAGMA journal_mode = DELETE")
    except (sqlite3.Error, OSError) as error:
        with suppress(OSError):
            copy.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise _output_error(path, why, describe_refusal(error)) from error
        if is_temporary(error):
            raise _output_error(path, why, describe_failure(path, error)) from error
        connection.close()
        return replace_database(folder, shift_ns, sums, why)
    try:
        connection.close()
        moved = move_database_aside(path)
        commit_file(copy, path)
    except OSError as error:
        raise _output_error(path, why, describe_refusal(error)) from error
    message = f"{path}: {why}; it was written again with all records and totals"
    if moved.exists():
        message += f", what was found there is in {moved.parent}"
    return OpenedDatabase(open_writer(path), sums, sums.number, message)


def correct_end(connection: sqlite3.Connection, sums: LedgerTotals) -> bool:
    """Set the stored end of the ledger to ``sums`` if it differs; return whether it did.

    Raises
    ------
    sqlite3.Error
        When the tables are not those of a history.
    """
    stored = connection.execute("SELECT number, end_mm, state FROM ledger").fetchone()
    connection.execute("SELECT max(number) FROM records").fetchone()
    expected = (sums.number, sums.end_mm, sums.text())
    if stored == expected or (stored is not None and not sums.number and stored == (0, None, "")):
        return False
    with transaction(connection):
        connection.execute("INSERT OR IGNORE INTO ledger VALUES (1, 0, 0, NULL, NULL, '')")
        set_sums(connection, sums)
    return True


def _output_error(path: Path, why: str, reason: str) -> OutputError:
    return OutputError(f"{path}: {why}; it is not written again yet: {reason}")


def _require_sound(connection: sqlite3.Connection) -> None:
    result = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if result != "ok":
        raise sqlite3.DatabaseError(" ".join(result.split()))
