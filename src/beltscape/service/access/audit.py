"""The audit log ``audit.jsonl``: who did what, when and from where, one JSON object per line, append-only."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

FILE = "audit.jsonl"
_ENTRY_BYTES = 1024
"""Bytes per entry from which the latest entries are read; an entry has some 200."""
_MAX_VALUE_LENGTH = 300
"""Longer values are cut, so that no request can fill the log."""


class Audit:
    """The audit log of a data folder. Thread-safe; entries lost to a full disk are counted, not raised."""

    def __init__(
        self, folder: Path, file_bytes: int, files: int, clock: Callable[[], float] = time.time
    ) -> None:
        self.path = folder / FILE
        self._file_bytes, self._files, self._clock = file_bytes, files, clock
        self._lock = threading.Lock()
        self.lost_entries = 0
        """Entries that could not be written."""

    def set_size(self, file_bytes: int, files: int) -> None:
        """Rotate at another size, and keep another number of files."""
        self._file_bytes, self._files = file_bytes, files

    def write(
        self,
        action: str,
        actor: str,
        address: str = "",
        detail: Mapping[str, str | int | float] | None = None,
    ) -> None:
        """Append one entry; it is on disk when this returns. Values are cut at 300 characters."""
        entry = {
            "at": datetime.fromtimestamp(self._clock(), UTC).isoformat(timespec="milliseconds"),
            "what": action,
            "who": actor[:_MAX_VALUE_LENGTH],
            "from": address[:_MAX_VALUE_LENGTH],
            **{key: v[:_MAX_VALUE_LENGTH] if isinstance(v, str) else v for key, v in (detail or {}).items()},
        }
        # ASCII only, so that no control character, line end or look-alike letter can fake an entry
        line = json.dumps(entry, ensure_ascii=True) + "\n"
        with self._lock:
            try:
                self._rotate()
                self._append(line.encode())
            except OSError:
                self.lost_entries += 1

    def read_last(self, count: int) -> list[dict[str, Any]]:
        """Return the newest entries of the current file, newest first."""
        with self._lock:
            try:
                with self.path.open("rb") as file:
                    file.seek(max(0, file.seek(0, os.SEEK_END) - _ENTRY_BYTES * count))
                    lines = file.read().splitlines()
            except OSError:
                return []
        entries: list[dict[str, Any]] = []
        for line in reversed(lines[-count:]):
            try:
                entries.append(json.loads(line))
            except ValueError:
                continue  # cut by the seek, or by a power failure
        return entries

    def _append(self, line: bytes) -> None:
        with open(self.path, "a+b", opener=_open_private) as file:
            # a line cut by a power failure must not join the next one
            end = file.seek(0, os.SEEK_END)
            file.seek(max(0, end - 1))
            is_torn = end > 0 and file.read(1) != b"\n"
            file.write(b"\n" * is_torn + line)
            file.flush()
            os.fsync(file.fileno())

    def _rotate(self) -> None:
        if not self.path.exists() or self.path.stat().st_size < self._file_bytes:
            return
        stamp = datetime.fromtimestamp(self._clock(), UTC).strftime("%Y%m%dT%H%M%S%f")
        self.path.rename(self.path.with_name(f"audit-{stamp}.jsonl"))
        old = sorted(self.path.parent.glob("audit-*.jsonl"))
        for path in old[: max(0, len(old) - self._files)]:
            path.unlink()


def _open_private(path: str, flags: int) -> int:
    """Open a file that only its owner may read."""
    return os.open(path, flags, 0o600)
