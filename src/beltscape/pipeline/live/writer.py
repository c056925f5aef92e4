"""Entries on their way to a sink, in a thread of its own: a slow disk holds up no frame, a full one loses nothing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import BeltscapeError
from beltscape.core.live import RecordSink

_AGAIN_S = 1.0
_WITH_SECTION = 20_000
"""So many waiting entries keep their cross-sections; of more, the oldest are kept without."""
_BATCH = 500


class Writer:
    """Gives entries to one sink, in order; what it refuses is kept and offered again."""

    def __init__(
        self, name: str, sink: RecordSink, written: Callable[[Sequence[BeltRecord]], None] | None = None
    ) -> None:
        """``written`` is told what the sink has taken."""
        self.trouble = ""
        """What the sink said when it last refused; empty while all goes well."""
        self._sink, self._written = sink, written
        self._waiting: list[BeltRecord] = []
        self._changed = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=f"writer-{name}", daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, entries: Sequence[BeltRecord]) -> None:
        """Further entries; returns at once."""
        with self._changed:
            self._waiting.extend(entries)
            for index in range(len(self._waiting) - _WITH_SECTION - 1, -1, -1):
                if self._waiting[index].section is None:
                    break
                self._waiting[index] = replace(self._waiting[index], section=None)
            self._changed.notify_all()

    def close(self, patience_s: float = 10.0) -> int:
        """Write what waits; how many entries the sink would not take within the time. It stays open."""
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
                self._changed.wait(_AGAIN_S)

    def _offer(self, batch: list[BeltRecord]) -> bool:
        try:
            self._sink.write(batch)
        except (BeltscapeError, OSError) as error:
            self.trouble = str(error)
            return False
        self.trouble = ""
        with self._changed:
            del self._waiting[: len(batch)]
        if self._written is not None:
            self._written(batch)
        return True
