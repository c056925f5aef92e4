"""A writer thread per sink: a slow disk delays no frame, and entries that a sink refuses are offered again.

The CSV tables of a run begin with the records that they lack, and may be switched while it runs.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from beltscape.core.errors import BeltscapeError, OutputError
from beltscape.core.interfaces import Observer, RecordSink
from beltscape.core.ledger import BeltRecord
from beltscape.core.supervision import make_supervised_thread
from beltscape.sinks.csv_sink import CsvSink
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import CsvSettings

_RETRY_S = 1.0
"""Wait after a failed write."""
_WITH_SECTION = 20_000
"""Number of waiting entries that keep their cross-sections; older ones lose theirs, which bounds the memory."""
BATCH = 500
"""Entries written in one transaction."""


Entry = TypeVar("Entry")
_Entry_contra = TypeVar("_Entry_contra", contravariant=True)


class Sink(Protocol[_Entry_contra]):
    """A destination of entries; a `RecordSink` is one of records."""

    def write(self, records: Sequence[_Entry_contra], /) -> None:
        """Store the entries in order, all or none; after an OutputError the same ones are offered again."""
        ...


class Writer(Generic[Entry]):
    """Writes entries to one sink in order; refused entries are kept and offered again."""

    def __init__(
        self,
        name: str,
        sink: Sink[Entry],
        on_written: Callable[[Sequence[Entry]], None] | None = None,
        bound: Callable[[list[Entry]], None] = lambda _: None,
    ) -> None:
        """``on_written`` is called with the entries that the sink has stored.

        ``bound`` shortens the waiting entries in place where they are too many for the memory.
        """
        self.trouble = ""
        """The sink's last error; empty once it stores again."""
        self._sink, self._on_written = sink, on_written
        self._bound = bound
        self._waiting: list[Entry] = []
        self._added = 0
        """Entries that were put since the start."""
        self._changed = threading.Condition()
        self._closing = False
        self._thread = make_supervised_thread(
            f"writer-{name}", self._run, self._on_failure, self._wait_to_stop
        )
        self._thread.start()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, entries: Sequence[Entry]) -> None:
        """Append entries; returns at once."""
        with self._changed:
            self._waiting.extend(entries)
            self._added += len(entries)
            self._bound(self._waiting)
            self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Wait until the sink has taken, or lost, what was put before; return whether it has in time."""
        with self._changed:
            until = self._added
            return self._changed.wait_for(lambda: self._added - len(self._waiting) >= until, seconds)

    def close(self, patience_s: float = 10.0) -> int:
        """Write the waiting entries; return how many were not stored in time. The sink stays open."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(patience_s)
        return len(self._waiting)

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._closing:
                    self._changed.wait()
                batch = self._waiting[:BATCH]
            if not batch:
                return
            if self._offer(batch):
                continue
            with self._changed:
                if self._closing:
                    return
                self._changed.wait(_RETRY_S)

    def _on_failure(self, failure: str) -> None:
        self.trouble = f"writing failed ({failure}) and starts again; the entries wait"

    def _wait_to_stop(self, seconds: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: self._closing, seconds)

    def _offer(self, batch: list[Entry]) -> bool:
        try:
            self._sink.write(batch)
        except (BeltscapeError, OSError) as error:
            self.trouble = str(error)
            return False
        self.trouble = ""
        with self._changed:
            del self._waiting[: len(batch)]
            self._changed.notify_all()
        if self._on_written is not None:
            self._on_written(batch)
        return True


def drop_old_sections(waiting: list[BeltRecord]) -> None:
    """Let the oldest of very many waiting records lose their cross-sections."""
    for index in range(len(waiting) - _WITH_SECTION - 1, -1, -1):
        if waiting[index].section is None:
            break
        waiting[index] = replace(waiting[index], section=None)


def make_record_writer(
    name: str, sink: RecordSink, on_written: Callable[[Sequence[BeltRecord]], None] | None = None
) -> Writer[BeltRecord]:
    """Return the writer of records to a sink; see `Writer`."""
    return Writer(name, sink, on_written, drop_old_sections)


def notify_records(observer: Observer, historian: Historian) -> Callable[[Sequence[BeltRecord]], None]:
    """Return a function that passes stored records and the historian's totals to the observer."""
    return lambda records: observer.on_records(records, historian.totals)


_END_OF_TIME_NS, _PAGE = 1 << 62, 5000
"""A time after every record, and the number of records read at once."""


class CsvTable:
    """A ``RecordSink`` of CSV tables; nothing is written while the settings switch them off."""

    def __init__(self, folder: Path, settings: CsvSettings, historian: Historian) -> None:
        """Open the tables and add the history's records that they lack, such as those lost in a power cut.

        Raises
        ------
        InputError, OutputError
            See ``CsvSink``.
        """
        self._folder, self._historian = folder, historian
        self._sink: CsvSink | None = None
        self.prepare(settings)()
        self._catch_up()

    def prepare(self, settings: CsvSettings) -> Callable[[], None]:
        """Open the tables with other settings; return what makes them the present ones. The errors of ``CsvSink``."""
        sink = CsvSink(self._folder, settings) if settings.enabled else None

        def exchange() -> None:
            self._sink = sink

        return exchange

    def write(self, records: Sequence[BeltRecord]) -> None:
        """Write the records, and before them those that the tables lack; OutputError while the history lacks them."""
        sink = self._sink
        if sink is None or not records:
            return
        before = records[0].number - 1
        if sink.last < before:
            self._catch_up()
            if sink.last < min(before, self._historian.ledger_end.number):
                raise OutputError(f"{self._folder}: waits for record {before} of the history")
        sink.write(records)

    def close(self) -> None:
        """Do nothing: no file is open between calls."""

    def _catch_up(self) -> None:
        sink = self._sink
        while sink is not None and (
            missing := self._historian.records(0, _END_OF_TIME_NS, limit=_PAGE, after=sink.last)
        ):
            sink.write(missing)
