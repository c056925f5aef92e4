"""The historian: every record on disk, totals that survive everything, history at hand."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.belt.ledger_entries import BeltRecord, CrossSection, Totals
from beltscape.core.errors import OutputError
from beltscape.sinks.historian.archive.retention import Retention
from beltscape.sinks.historian.reading.events import Event, add_event, read_events
from beltscape.sinks.historian.reading.periods import DaySum, past_days, past_records, past_section
from beltscape.sinks.historian.reading.series import Series, read_series
from beltscape.sinks.historian.writing.store import Store
from beltscape.sinks.settings import HistorySettings


@dataclass(frozen=True, slots=True)
class Resume:
    """Where the ledger ends."""

    number: int
    """Of the last record: the next one has number + 1; 0 while there is none."""
    run: int
    """The last record's; 0 while there is none."""
    end_mm: float | None
    """Where the belt's last stretch ends; None while there is none."""
    offset_mm: float = 0.0
    """What the ledger's count is ahead of the encoder's there."""


class Historian:
    """A ``RecordSink`` that forgets nothing: SQLite now, Parquet for closed days.

    Everything may be called from any thread; reading never holds writing up.
    """

    def __init__(self, folder: Path, settings: HistorySettings) -> None:
        """Open or make the history in ``folder``; it is this process's alone until it is closed.

        Raises
        ------
        InputError
            When another process has it open, or a newer version or another program made it.
        SettingsError
            When its days begin at another hour.
        OutputError
            When it cannot be written.
        """
        self._store = Store(folder, settings)
        self._days = folder / "days"
        self._retention = Retention(self._days, self._store, settings)
        self._tending = ""
        if self._store.message:
            with suppress(OutputError):  # it is told by ``mended`` all the same
                self.note("note", "history", self._store.message)

    @property
    def mended(self) -> str:
        """What had to be mended of a damaged database, in one line; empty where nothing. It is an event too."""
        return self._store.message

    @property
    def trouble(self) -> str:
        """Why less is kept than should be, in one line; empty while all is well."""
        return self._store.trouble or self._tending

    @property
    def resume(self) -> Resume:
        """Where the ledger ends."""
        sums = self._store.sums
        return Resume(sums.number, sums.run, sums.end_mm, sums.offset_mm)

    @property
    def totals(self) -> Totals:
        """What the ledger adds up to; kept for ever, whatever is pruned."""
        return self._store.sums.totals

    def begin_run(self) -> int:
        """Note a new start of the program; its number, above all before.

        Raises
        ------
        OutputError
            When it cannot be written.
        """
        row = "INSERT INTO runs (wall_ns) VALUES (?)"
        return self._store.change(
            lambda connection: connection.execute(row, (time.time_ns(),)).lastrowid or 0
        )

    def write(self, records: Sequence[BeltRecord]) -> None:
        """Keep records with their sections and what they add to the totals; on disk when it returns.

        All of them or none. Those that are kept already are passed over, so asking again does no harm.

        Raises
        ------
        InputError
            When a number is left out, or a stretch of belt does not begin where the ledger ended.
        OutputError
            When it cannot be written now; ask again.
        """
        self._store.write(records)

    def note(self, kind: str, name: str, text: str, by: str = "", wall_ns: int | None = None) -> None:
        """Keep an event, such as an alarm; on disk when it returns. OutputError where it cannot be written."""
        when = time.time_ns() if wall_ns is None else wall_ns
        self._store.change(lambda connection: add_event(connection, when, kind, name, text, by))

    def events(self, since_ns: int, until_ns: int, limit: int = 1000) -> tuple[Event, ...]:
        """Events of that time (the end is not in it), newest first."""
        with self._store.readers.reading() as connection:
            return read_events(connection, since_ns, until_ns, limit)

    def records(
        self, since_ns: int, until_ns: int, limit: int = 1000, after: int = 0, *, sections: bool = False
    ) -> tuple[BeltRecord, ...]:
        """The first ``limit`` records of that time with numbers above ``after``, in the ledger's order.

        ``after`` the last one's number gives the next page. Days long past come from their files.
        """
        with self._store.readers.reading() as connection:
            return past_records(
                connection,
                self._days,
                (since_ns, until_ns),
                after,
                limit,
                self._store.shift_ns,
                sections=sections,
            )

    def series(self, since_ns: int, until_ns: int, points: int = 600) -> Series:
        """At most so many intervals of that time, for charts."""
        with self._store.readers.reading() as connection:
            return read_series(connection, since_ns, until_ns, points, self._store.shift_ns)

    def section(self, number: int) -> CrossSection | None:
        """The cross-section behind that record, heights to 1/64 mm; None where none is kept."""
        with self._store.readers.reading() as connection:
            return past_section(connection, self._days, number)

    def day_totals(self, since_ns: int, until_ns: int) -> tuple[DaySum, ...]:
        """What passed on every day that begins in that time, oldest first."""
        with self._store.readers.reading() as connection:
            return past_days(connection, since_ns, until_ns, self._store.shift_ns)

    def tend(self, wall_ns: int | None = None) -> None:
        """Close days that are over and keep within the limits; call it once a minute from a thread with time.

        What goes wrong is ``trouble`` until it has gone well.
        """
        self._tending = self._retention.tend(time.time_ns() if wall_ns is None else wall_ns)

    def close(self) -> None:
        """Nothing more is written or read."""
        self._store.close()
