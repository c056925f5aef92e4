"""A writer thread per sink: a slow disk delays no frame, and entries that a sink refuses are offered again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import BeltscapeError
from beltscape.core.live.interfaces import Observer, RecordSink
from beltscape.core.runtime.supervision import make_supervised_thread
from beltscape.sinks.historian import Historian

_RETRY_S = 1.0
"""Wait after a failed write."""
_WITH_SECTION = 20_000
"""Number of waiting entries that keep their cross-sections; older ones lose theirs, which bounds the memory."""
_BATCH = 500
"""Entries written in one transaction."""


class Writer:
    """Writes entries to one sink in order; refused entries are kept and offered again."""

    def __init__(
        self, name: str, sink: RecordSink, on_written: Callable[[Sequence[BeltRecord]], None] | None = None
    ) -> None:
        """``on_written`` is called with the entries that the sink has stored."""
        self.trouble = ""
        """The sink's last error; empty once it stores again."""
        self._sink, self._on_written = sink, on_written
        self._waiting: list[BeltRecord] = []
        self._changed = threading.Condition()
        self._closing = False
        self._thread = make_supervised_thread(
            f"writer-{name}", self._run, self._on_failure, self._wait_to_stop
        )
        self._thread.start()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, entries: Sequence[BeltRecord]) -> None:
        """Append entries; returns at once."""
        with self._changed:
            self._waiting.extend(entries)
            for index in range(len(self._waiting) - _WITH_SECTION - 1, -1, -1):
                if self._waiting[index].section is None:
                    break
                self._waiting[index] = replace(self._waiting[index], section=None)
            self._changed.notify_all()

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
                batch = self._waiting[:_BATCH]
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

    def _offer(self, batch: list[BeltRecord]) -> bool:
        try:
            self._sink.write(batch)
        except (BeltscapeError, OSError) as error:
            self.trouble = str(error)
            return False
        self.trouble = ""
        with self._changed:
            del self._waiting[: len(batch)]
        if self._on_written is not None:
            self._on_written(batch)
        return True


def notify_records(observer: Observer, historian: Historian) -> Callable[[Sequence[BeltRecord]], None]:
    """Return a function that passes stored records and the historian's totals to the observer."""
    return lambda records: observer.on_records(records, historian.totals)
