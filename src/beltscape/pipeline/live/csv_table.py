"""The CSV tables of a run: they begin with the records that they lack, and may be switched while it runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import OutputError
from beltscape.sinks.csv_sink import CsvSink
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import CsvSettings

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
