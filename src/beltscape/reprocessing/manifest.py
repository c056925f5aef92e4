"""The manifest of a re-processing: which pieces are done, with their results, in one SQLite file."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.errors import InputError, OutputError

FILE = "manifest.sqlite"
_FORMAT = "beltscape-reprocessing/1"
_SCHEMA = """
CREATE TABLE IF NOT EXISTS about (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS pieces (
  key TEXT PRIMARY KEY, recording TEXT NOT NULL, result BLOB NOT NULL,
  worker TEXT NOT NULL, begin_s REAL NOT NULL, seconds REAL NOT NULL
) WITHOUT ROWID;
"""
_LOCK_S = 5.0
"""Wait for another process that has the file open for a moment."""


@dataclass(frozen=True, slots=True)
class WorkSpan:
    """When and where a piece was measured."""

    worker: str
    """Machine and process."""
    begin_s: float
    """System clock at its begin, s since 1970."""
    seconds: float


class Manifest:
    """The pieces that are done; one process at a time has it open. What is added is on disk when the call returns."""

    def __init__(self, folder: Path, digest: str) -> None:
        """Open or create it; ``digest`` is that of what is measured by.

        Raises
        ------
        InputError
            When it belongs to another rig, empty belt, settings or version, or is in use.
        OutputError
            When it cannot be written.
        """
        self._path = folder / FILE
        try:
            self._connection = sqlite3.connect(self._path, timeout=_LOCK_S, isolation_level=None)
            self._connection.executescript(
                "PRAGMA locking_mode=EXCLUSIVE; PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL;" + _SCHEMA
            )
        except sqlite3.OperationalError as error:
            if "locked" in str(error):
                raise InputError(
                    f"{self._path}: another re-processing writes it; wait for its end"
                ) from error
            raise OutputError(f"{self._path}: cannot be written ({error})") from error
        except sqlite3.DatabaseError as error:
            raise InputError(f"{self._path}: is damaged ({error}); remove {folder} and start anew") from error
        self._require("format", _FORMAT, "another version of Beltscape")
        self._require(
            "measured by", digest, "another rig, empty belt, settings of measuring or version of Beltscape"
        )

    def _require(self, key: str, value: str, what: str) -> None:
        self._connection.execute("INSERT OR IGNORE INTO about VALUES (?, ?)", (key, value))
        (stored,) = self._connection.execute("SELECT value FROM about WHERE key = ?", (key,)).fetchone()
        if stored != value:
            self.close()
            raise InputError(f"{self._path}: measured by {what}; give another folder with --out")

    def read_about(self, key: str) -> str:
        """Return a note; empty where there is none."""
        row = self._connection.execute("SELECT value FROM about WHERE key = ?", (key,)).fetchone()
        return "" if row is None else str(row[0])

    def write_about(self, key: str, value: str) -> None:
        """Store a note."""
        self._connection.execute("INSERT OR REPLACE INTO about VALUES (?, ?)", (key, value))

    def list_keys(self) -> set[str]:
        """Return the keys of all pieces that are done."""
        return {key for (key,) in self._connection.execute("SELECT key FROM pieces")}

    def add(self, key: str, recording: str, result: bytes, span: WorkSpan) -> None:
        """Store a piece's ``result``, as `history.encode_result` encodes it; OutputError if that fails."""
        try:
            self._connection.execute(
                "INSERT OR REPLACE INTO pieces VALUES (?, ?, ?, ?, ?, ?)",
                (key, recording, result, span.worker, span.begin_s, span.seconds),
            )
        except sqlite3.Error as error:
            raise OutputError(
                f"{self._path}: cannot be written ({error}); free some space and run again"
            ) from error

    def read_results(self, keys: Iterable[str]) -> Iterator[bytes | None]:
        """Yield the results of the pieces with these keys in order; None for one that is not done."""
        for key in keys:
            row = self._connection.execute("SELECT result FROM pieces WHERE key = ?", (key,)).fetchone()
            yield None if row is None else row[0]

    def list_spans(self) -> list[WorkSpan]:
        """Return when and where all pieces that are done were measured, in the order of their begins."""
        rows = self._connection.execute("SELECT worker, begin_s, seconds FROM pieces ORDER BY begin_s, key")
        return [WorkSpan(*row) for row in rows]

    def remove_others(self, keys: Iterable[str]) -> None:
        """Remove the pieces with other keys, which the source no longer has."""
        with closing(self._connection.cursor()) as cursor:
            cursor.execute("BEGIN")
            cursor.executemany(
                "DELETE FROM pieces WHERE key = ?", [(key,) for key in self.list_keys() - set(keys)]
            )
            cursor.execute("COMMIT")

    def close(self) -> None:
        """Close the file."""
        self._connection.close()
