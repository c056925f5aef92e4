"""Recovery of the ledger's end and totals from the day files and the tables in csv/, where they reach further.

A database that was emptied or replaced by an older one, without a readable ``totals.json``, would otherwise begin
again with numbers and belt positions that were given out before.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import InputError
from beltscape.sinks.csv_rows import PATTERN, read_last_number, read_records
from beltscape.sinks.historian.storage.day_files import UNBOUNDED, DayFile, read_day, read_summary
from beltscape.sinks.historian.writing.ledger import append_records, set_sums, transaction
from beltscape.sinks.historian.writing.sums import Sums

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

    sums: Sums
    message: str
    """Line that describes what was recovered and what is missing; empty if nothing was."""


class _CatchUp:
    """Adds the records that files have behind the database's end."""

    def __init__(self, connection: sqlite3.Connection, sums: Sums) -> None:
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


def catch_up(connection: sqlite3.Connection, sums: Sums, folder: Path, shift_ns: int) -> CaughtUp:
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
