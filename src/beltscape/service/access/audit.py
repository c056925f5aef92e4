"""Who did what, when and from where: ``audit.jsonl``, one JSON object a line, only ever appended to."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path

FILE = "audit.jsonl"
_LONGEST = 300


class Audit:
    """The audit log of a data folder; for any thread. A full disk is counted, never raised."""

    def __init__(
        self, folder: Path, file_bytes: int, files: int, clock: Callable[[], float] = time.time
    ) -> None:
        self.path = folder / FILE
        self._file_bytes, self._files, self._clock = file_bytes, files, clock
        self._lock = threading.Lock()
        self.lost = 0
        """Entries that could not be written."""

    def write(
        self, what: str, who: str, address: str = "", detail: Mapping[str, str | int | float] | None = None
    ) -> None:
        """Append one entry; it is on disk when this returns. Values are cut at 300 characters."""
        entry = {
            "at": datetime.fromtimestamp(self._clock(), UTC).isoformat(timespec="milliseconds"),
            "what": what,
            "who": who[:_LONGEST],
            "from": address[:_LONGEST],
            **{key: v[:_LONGEST] if isinstance(v, str) else v for key, v in (detail or {}).items()},
        }
        # ASCII only: no control character, line end or look-alike letter can fake an entry
        line = json.dumps(entry, ensure_ascii=True) + "\n"
        with self._lock:
            try:
                self._set_aside()
                self._append(line.encode())
            except OSError:
                self.lost += 1

    def last(self, most: int) -> list[dict]:
        """The newest entries of the current file, newest first."""
        with self._lock:
            try:
                with self.path.open("rb") as file:
                    file.seek(max(0, file.seek(0, os.SEEK_END) - 1024 * most))
                    lines = file.read().splitlines()
            except OSError:
                return []
        entries = []
        for line in reversed(lines[-most:]):
            try:
                entries.append(json.loads(line))
            except ValueError:
                continue  # cut by the seek, or by a power failure
        return entries

    def _append(self, line: bytes) -> None:
        file = os.open(self.path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o600)
        try:
            size = os.fstat(file).st_size
            # a line that a power failure cut must not swallow the next one
            torn = size > 0 and os.pread(file, 1, size - 1) != b"\n"
            os.write(file, b"\n" * torn + line)
            os.fsync(file)
        finally:
            os.close(file)

    def _set_aside(self) -> None:
        if not self.path.exists() or self.path.stat().st_size < self._file_bytes:
            return
        stamp = datetime.fromtimestamp(self._clock(), UTC).strftime("%Y%m%dT%H%M%S%f")
        self.path.rename(self.path.with_name(f"audit-{stamp}.jsonl"))
        old = sorted(self.path.parent.glob("audit-*.jsonl"))
        for path in old[: max(0, len(old) - self._files)]:
            path.unlink()
