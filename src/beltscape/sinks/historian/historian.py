"""The historian's interface: writing records and events, reading totals, records, series and events."""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.errors import OutputError
from beltscape.core.ledger import BeltRecord, CrossSection, Totals
from beltscape.sinks.historian.archive import Retention
from beltscape.sinks.historian.drift import StoredDrift, insert_drift, read_first_drift
from beltscape.sinks.historian.events import (
    Event,
    NewEvent,
    Run,
    insert_events,
    read_events,
    read_journal,
    read_runs,
)
from beltscape.sinks.historian.finding_days import FindingArchive
from beltscape.sinks.historian.findings import (
    CheckKey,
    FindingSeries,
    StoredFinding,
    append_findings,
    list_checks,
    read_finding_series,
)
from beltscape.sinks.historian.ledger import transaction
from beltscape.sinks.historian.periods import (
    DaySum,
    Series,
    read_day_sums,
    read_records,
    read_section,
    read_series,
)
from beltscape.sinks.historian.production_history import ProductionHistory
from beltscape.sinks.historian.store import Store
from beltscape.sinks.settings import HistorySettings


@dataclass(frozen=True, slots=True)
class LedgerEnd:
    """The end of the ledger."""

    number: int
    """Number of the last record: the next one has number + 1; 0 without records."""
    run: int
    """Run of the last record; 0 without records."""
    end_mm: float | None
    """End of the belt's last stretch; None without records."""
    offset_mm: float = 0.0
    """The ledger's count minus the encoder's at that end."""


class Historian:
    """A ``RecordSink`` with permanent storage: SQLite, and Parquet for closed days.

    All methods may be called from any thread; reading never blocks writing.
    """

    def __init__(self, folder: Path, settings: HistorySettings) -> None:
        """Open or create the history in ``folder`` for this process alone, until it is closed.

        Raises
        ------
        InputError
            When another process has it open, or a newer version or another program created it.
        SettingsError
            When its days begin at another hour.
        OutputError
            When it cannot be written.
        """
        self._store = Store(folder, settings)
        self.production = ProductionHistory(self._store)
        """Products, batches, sums of shifts, and the belt scale."""
        self._days = folder / "days"
        self._findings = FindingArchive(folder / "findings", self._store, settings)
        self._retention = Retention(self._days, self._store, settings, (self._findings.maintain,))
        self._maintenance_trouble = ""
        self._verify_trouble = ""
        self._noted = ""
        self._note_repair()

    def set_settings(self, settings: HistorySettings) -> None:
        """Keep by other settings from now on; the reserve and the hour at which days begin stay until a restart."""
        for part in (self._store, self._findings, self._retention):
            part.set_settings(settings)

    @property
    def repair_message(self) -> str:
        """Line that describes the last repair of the database, also stored as an event; empty without a repair.

        Repairs are made when the history is opened, by ``verify``, and by every call that writes.
        """
        return self._store.message

    @property
    def trouble(self) -> str:
        """Reason in one line if the history is stored only in part; empty without a fault."""
        return self._store.trouble or self._verify_trouble or self._maintenance_trouble

    def verify(self) -> None:
        """Repair the database if another program has deleted, replaced or changed it; call it every second.

        A failure is in ``trouble`` until the next success.
        """
        try:
            self._store.verify()
            self._verify_trouble = ""
        except OutputError as error:
            self._verify_trouble = str(error)
        self._note_repair()

    def _note_repair(self) -> None:
        message = self._store.message
        if message != self._noted:
            self._noted = message
            with suppress(OutputError):  # ``repair_message`` has it as well
                self.add_event("note", "history", message)

    @property
    def ledger_end(self) -> LedgerEnd:
        """The end of the ledger."""
        sums = self._store.sums
        return LedgerEnd(sums.number, sums.run, sums.end_mm, sums.offset_mm)

    @property
    def totals(self) -> Totals:
        """Totals of the ledger, including records that were removed since."""
        return self._store.sums.totals

    def begin_run(self, provenance: Mapping[str, str] | None = None) -> int:
        """Store a new run and return its number, which is higher than all earlier ones.

        A run is the program's work with one rig, empty belt and settings of measuring, which ``provenance`` names.

        Raises
        ------
        OutputError
            When it cannot be written.
        """
        values = time.time_ns(), json.dumps(dict(provenance or {}))
        row = "INSERT INTO runs (wall_ns, provenance) VALUES (?, ?)"
        return self._store.transact(lambda connection: connection.execute(row, values).lastrowid or 0)

    def list_runs(self, limit: int) -> list[Run]:
        """Return the newest runs, the newest first. InputError if they cannot be read."""
        with self._store.readers.borrow() as connection:
            return read_runs(connection, limit)

    def write(self, records: Sequence[BeltRecord]) -> None:
        """Store records with their sections and update the totals; they are on disk when the call returns.

        All or none are stored. Records that are stored already are skipped, so a call may be repeated.

        Raises
        ------
        InputError
            When a number is missing, or a stretch of belt does not begin at the end of the ledger.
        OutputError
            When they cannot be written now; repeat the call.
        """
        self._store.write(records)
        self._note_repair()

    def add_event(
        self,
        kind: str,
        name: str,
        text: str,
        by: str = "",
        wall_ns: int | None = None,
        parameters: Mapping[str, object] | None = None,
    ) -> None:
        """Store an event, such as an alarm; it is on disk when the call returns. OutputError otherwise.

        ``parameters``: the parts of the text, from which a page composes it in another language.
        """
        when = time.time_ns() if wall_ns is None else wall_ns
        self.add_events((NewEvent(kind, name, text, when, by, parameters),))

    def add_events(self, events: Sequence[NewEvent]) -> None:
        """Store events in their order, all or none; they are on disk when the call returns. OutputError otherwise."""

        def work(connection: sqlite3.Connection) -> None:
            with transaction(connection):
                insert_events(connection, events)

        self._store.transact(work)

    def add_findings(self, findings: Sequence[StoredFinding]) -> None:
        """Store findings; they are on disk when the call returns. OutputError otherwise.

        While the disk is short they are left out: the reserved space is the records'.
        """
        if findings and not self._store.trouble:
            self._store.transact(lambda connection: append_findings(connection, findings))

    def add_drift(self, wall_ns: int, rig: str, document: Mapping[str, object]) -> None:
        """Store an estimate of the drift of a rig, by the SHA-256 of its file. OutputError otherwise."""
        self._store.transact(lambda connection: insert_drift(connection, wall_ns, rig, document))

    def read_first_drift(self, rig: str) -> StoredDrift | None:
        """Return the first estimate of a rig's drift, the reference of all others; None before it."""
        with self._store.readers.borrow() as connection:
            return read_first_drift(connection, rig)

    def checks(self) -> tuple[CheckKey, ...]:
        """Return all series of findings that have ever been stored."""
        with self._store.readers.borrow() as connection:
            return list_checks(connection)

    def finding_series(
        self, check: str, subject: str, since_ns: int, until_ns: int, points: int = 300
    ) -> FindingSeries:
        """Return the findings of one check in a period in at most ``points`` intervals.

        Old days are read from their files where the period is at most two days.
        """
        with self._store.readers.borrow() as connection:
            times_ns = (since_ns, until_ns)
            return read_finding_series(
                connection, self._findings.folder, (check, subject), times_ns, points, self._store.shift_ns
            )

    def events(self, since_ns: int, until_ns: int, limit: int = 1000) -> tuple[Event, ...]:
        """Return the events of a period (its end excluded), newest first."""
        with self._store.readers.borrow() as connection:
            return read_events(connection, since_ns, until_ns, limit)

    def alarm_journal(
        self,
        since_ns: int,
        until_ns: int,
        after: int = 0,
        limit: int = 1000,
        name: str = "",
        *,
        newest: bool = False,
    ) -> tuple[Event, ...]:
        """Return events about alarms with numbers above ``after``: the oldest ones first, or the newest ones first.

        ``name``: of this alarm alone.
        """
        with self._store.readers.borrow() as connection:
            return read_journal(connection, (since_ns, until_ns), after, limit, name, newest=newest)

    def records(
        self, since_ns: int, until_ns: int, limit: int = 1000, after: int = 0, *, sections: bool = False
    ) -> tuple[BeltRecord, ...]:
        """Return the first ``limit`` records of a period with numbers above ``after``, in the ledger's order.

        The last record's number as ``after`` gives the next page. Old days are read from their files. No record is
        behind ``ledger_end``: one that the database has committed an instant before comes with the next call.
        """
        end, shift_ns = self._store.sums.number, self._store.shift_ns
        with self._store.readers.borrow() as connection:
            found = read_records(
                connection, self._days, (since_ns, until_ns), after, limit, shift_ns, sections=sections
            )
        return tuple(record for record in found if record.number <= end)

    def series(self, since_ns: int, until_ns: int, points: int = 600) -> Series:
        """Return a period in at most ``points`` intervals, for charts."""
        with self._store.readers.borrow() as connection:
            return read_series(connection, since_ns, until_ns, points, self._store.shift_ns)

    def section(self, number: int) -> CrossSection | None:
        """Return the cross-section of a record, heights to 1/64 mm; None without a stored one."""
        with self._store.readers.borrow() as connection:
            return read_section(connection, self._days, number)

    def day_totals(self, since_ns: int, until_ns: int) -> tuple[DaySum, ...]:
        """Return the sums of every day that begins in a period, oldest first."""
        with self._store.readers.borrow() as connection:
            return read_day_sums(connection, since_ns, until_ns, self._store.shift_ns)

    def maintain(self, wall_ns: int | None = None) -> None:
        """Close past days and enforce the limits; call it once a minute from a background thread.

        A failure is in ``trouble`` until the next success.
        """
        self._maintenance_trouble = self._retention.maintain(time.time_ns() if wall_ns is None else wall_ns)

    def close(self) -> None:
        """Close the history; it can neither be written nor read afterwards."""
        self._store.close()
