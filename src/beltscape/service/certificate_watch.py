"""The newest certificate of the material test while a plant runs: until when it holds, and what changed since."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from time import time_ns

from beltscape.core.events import CertificateReading
from beltscape.metrology.certificate import Statement
from beltscape.pipeline.certifying.certificates import FOLDER, find_in_force


def read_wall_ms() -> int:
    """Return the system clock, ms since 1970."""
    return time_ns() // 1_000_000


class CertificateWatch:
    """Reads the folder of certificates when it has changed; may be called from any thread, twice a second."""

    def __init__(self, data: Path, now_ms: Callable[[], int] = read_wall_ms) -> None:
        """``data`` is the data folder."""
        self._data, self._now_ms = data, now_ms
        self._lock = threading.Lock()
        self._changed_ns: int | None = None
        self._statement: Statement | None = None

    def __call__(self, present: Mapping[str, str]) -> CertificateReading | None:
        """Return the newest certificate, against what is measured by now; None without one."""
        statement = self._read()
        if statement is None:
            return None
        days_left = statement.days_left(self._now_ms())
        return CertificateReading(statement.number, days_left, statement.list_changed(present))

    def _read(self) -> Statement | None:
        with self._lock:
            try:
                changed_ns = (self._data / FOLDER).stat().st_mtime_ns
            except OSError:
                return None
            if changed_ns != self._changed_ns:
                newest = find_in_force(self._data)
                self._statement = None if newest is None else newest.statement
                self._changed_ns = changed_ns
            return self._statement
