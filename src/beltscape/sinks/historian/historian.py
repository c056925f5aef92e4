"""The historian: every record on disk, totals that survive everything, history at hand."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.belt_record import BeltRecord, CrossSection, Totals
from beltscape.sinks.days import HOUR_NS
from beltscape.sinks.historian.events import Event, add_event, read_events
from beltscape.sinks.historian.ledger import append
from beltscape.sinks.historian.readers import Readers
from beltscape.sinks.historian.reading import database_records, database_section
from beltscape.sinks.historian.schema import open_writer
from beltscape.sinks.historian.series import Series, number_range, read_series
from beltscape.sinks.historian.sums import Sums, read_sums
from beltscape.sinks.settings import HistorySettings


@dataclass(frozen=True, slots=True)
class Resume:
    """Where the ledger ends."""

    number: int
    """Of the last record: the next one has number + 1; 0 while there is none."""
    run: int
    """The last run's; 0 while there is none."""
    end_mm: float | None
    """Where the belt's last stretch ends; None while there is none."""


class Historian:
    """A ``RecordSink`` on SQLite; reads from any thread."""

    def __init__(self, folder: Path, settings: HistorySettings) -> None:
        """Open or make the history in ``folder``."""
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._settings = folder, settings
        self._path = folder / "history.db"
        self._lock = threading.RLock()
        self._shift_ns = round(settings.day_begins_utc_h * HOUR_NS)
        self._connection = open_writer(self._path)
        self._sums = read_sums(self._connection.execute("SELECT state FROM ledger").fetchone()[0]) or Sums()
        self._readers = Readers(self._path)
        self.trouble = ""

    @property
    def resume(self) -> Resume:
        """Where the ledger ends."""
        return Resume(self._sums.number, self._sums.run, self._sums.end_mm)

    @property
    def totals(self) -> Totals:
        """What the ledger adds up to."""
        return self._sums.totals

    def begin_run(self) -> int:
        """A new start of the program; its number."""
        with self._lock:
            row = self._connection.execute("INSERT INTO runs (wall_ns) VALUES (?)", (time.time_ns(),))
            return int(row.lastrowid or 0)

    def write(self, records: Sequence[BeltRecord]) -> None:
        """Keep them; on disk when it returns."""
        with self._lock:
            self._sums = append(
                self._connection, self._sums, records, self._shift_ns, sections=self._settings.keep_sections
            )

    def note(self, kind: str, name: str, text: str, by: str = "", wall_ns: int | None = None) -> None:
        """Keep an event."""
        with self._lock:
            add_event(self._connection, time.time_ns() if wall_ns is None else wall_ns, kind, name, text, by)

    def events(self, since_ns: int, until_ns: int, limit: int = 1000) -> tuple[Event, ...]:
        """Events of that time, newest first."""
        with self._readers.reading() as connection:
            return read_events(connection, since_ns, until_ns, limit)

    def records(
        self, since_ns: int, until_ns: int, limit: int = 1000, after: int = 0, *, sections: bool = False
    ) -> tuple[BeltRecord, ...]:
        """Records of that time with numbers above ``after``, in order."""
        with self._readers.reading() as connection:
            numbers = number_range(connection, since_ns, until_ns, self._shift_ns)
            if numbers is None:
                return ()
            bounds = max(numbers[0], after + 1), numbers[1]
            return tuple(database_records(connection, bounds, (since_ns, until_ns), limit, sections=sections))

    def series(self, since_ns: int, until_ns: int, points: int = 600) -> Series:
        """History as curves."""
        with self._readers.reading() as connection:
            return read_series(connection, since_ns, until_ns, points, self._shift_ns)

    def section(self, number: int) -> CrossSection | None:
        """The cross-section behind that record; None where none is kept."""
        with self._readers.reading() as connection:
            return database_section(connection, number)

    def tend(self, wall_ns: int) -> None:
        """Close days, keep within the limits."""

    def close(self) -> None:
        """No more come."""
        with self._lock:
            self._readers.close()
            self._connection.close()
