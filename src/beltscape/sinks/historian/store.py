"""The only writer of the database: a lock, a connection, and handling of full disks and damaged files.

Reserved disk space is released when the disk is full. Changes to the open database by other programs are detected:
it is deleted, replaced, cut, overwritten, or written to.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import IO, TypeVar

from beltscape.core.errors import InputError, OutputError, SettingsError
from beltscape.core.ledger import BeltRecord
from beltscape.core.system_calls import lock_file, reserve_space
from beltscape.files.sqlite_failures import describe_failure, is_damage, is_full, is_temporary
from beltscape.sinks.days import compute_shift_ns
from beltscape.sinks.historian.database import ReaderPool, open_reader
from beltscape.sinks.historian.ledger import append_records
from beltscape.sinks.historian.recovery import (
    DATABASE,
    OpenedDatabase,
    correct_end,
    open_or_recover,
    replace_database,
    rescue_database,
    write_snapshot,
)
from beltscape.sinks.settings import HistorySettings


class Reserve:
    """A file without content that is deleted when no other space is free."""

    def __init__(self, path: Path, size_bytes: int) -> None:
        """Reserve space at ``path``; nothing is allocated yet."""
        self.path, self.size_bytes = path, size_bytes

    @property
    def is_held(self) -> bool:
        """True if the whole reserve is allocated."""
        try:
            return self.path.stat().st_size >= self.size_bytes
        except OSError:
            return False

    def free_bytes(self) -> int:
        """Return the free bytes of the disk; 0 if they are unknown."""
        try:
            return shutil.disk_usage(self.path.parent).free
        except OSError:
            return 0

    def allocate(self) -> bool:
        """Allocate the reserve if the disk has twice as much free; return whether it is allocated."""
        if self.is_held:
            return True
        if self.free_bytes() < 2 * self.size_bytes:
            return False
        try:
            with self.path.open("wb") as file:
                reserve_space(file, self.size_bytes)
        except OSError:
            self.release()
        return self.is_held

    def release(self) -> bool:
        """Delete the reserve; return whether there was one."""
        try:
            self.path.unlink()
        except OSError:
            return False
        return True


class FileWatch:
    """Remembers the state of a database after each own change, and compares it before the next."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        """``connection`` is the only writer of this process."""
        self._path, self._connection = path, connection
        self.remember()

    def remember(self) -> None:
        """Take the present state for the program's own; call it after each own change."""
        self._stat = _stat(self._path)
        self._version = self._data_version()

    def find_replacement(self) -> str:
        """Return how the file was replaced; empty if it is still the one that is open."""
        before, now = self._stat, _stat(self._path)
        if now is None:
            return "it was deleted while the program ran"
        if before is None or (now.st_dev, now.st_ino) != (before.st_dev, before.st_ino):
            return "it was replaced by another file while the program ran"
        if now.st_size < before.st_size:
            return f"it was cut from {before.st_size} to {now.st_size} bytes while the program ran"
        if now.st_mtime_ns != before.st_mtime_ns and (fault := self._find_damage()):
            return f"it was overwritten while the program ran ({fault})"
        self._stat = now
        return ""

    def is_written_by_others(self) -> bool:
        """Return whether another connection has committed a change; sqlite3.Error if the file cannot be read."""
        return self._data_version() != self._version

    def _data_version(self) -> int:
        return int(self._connection.execute("PRAGMA data_version").fetchone()[0])

    def _find_damage(self) -> str:
        """Return the first fault of the file on disk, which the writer's own page cache may hide."""
        try:
            with closing(open_reader(self._path)) as reader:
                result = str(reader.execute("PRAGMA quick_check(1)").fetchone()[0])
        except sqlite3.Error as error:
            return str(error)
        return "" if result == "ok" else " ".join(result.split())


def _stat(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except FileNotFoundError:
        return None


Result = TypeVar("Result")
REMOVED_AT_ONCE = 1_000
"""Rows removed from the database in one transaction, while writing waits: milliseconds. Chosen."""
_MIB = 1 << 20
"""Bytes of a MiB."""
_PAGES, _PAGES_SHORT = 1000, 40
"""Length of SQLite's log, pages: the default, and that for a full disk."""
_SNAPSHOT_S = 10.0
"""Interval at which the totals are also written beside the database: a lost one loses no more. Chosen."""


class Store:
    """Serialises changes to the history from any thread."""

    def __init__(self, folder: Path, settings: HistorySettings) -> None:
        """Open or create the history; it raises the errors of ``Historian``."""
        self.path = folder / DATABASE
        self.shift_ns = compute_shift_ns(settings.day_begins_utc_h)
        self._folder, self._settings = folder, settings
        self._lock = threading.RLock()
        self._guard = _lock_folder(folder)
        self._reserve = Reserve(folder / "reserve", settings.reserve_mib * _MIB)
        self.readers = ReaderPool(self.path)
        try:
            self._use(self._open_database())
            self.age = 0
            self._short = ""
            self._check_shift()
        except BaseException:
            self._guard.close()
            raise
        self._saved_s = float("-inf")
        if not self._reserve.allocate():
            self._short = "the disk is nearly full"

    @property
    def trouble(self) -> str:
        """Why the history is stored only in part, in one line; empty without a fault."""
        if not self._short:
            return ""
        return (
            f"{self._folder}: {self._short}; records and totals continue in reserved space, without "
            f"cross-sections; free {2 * self._reserve.size_bytes // _MIB} MiB, then all is stored again"
        )

    def write(self, records: Sequence[BeltRecord]) -> None:
        """Store records; see ``Historian.write``."""

        def work(connection: sqlite3.Connection) -> None:
            sections = self._settings.keep_sections and not self._short
            self.sums = append_records(connection, self.sums, records, self.shift_ns, sections=sections)

        self.transact(work)
        if time.monotonic() - self._saved_s >= _SNAPSHOT_S:
            self.save_totals()

    def set_settings(self, settings: HistorySettings) -> None:
        """Keep by other settings from the next call on."""
        self._settings = settings

    def transact(self, work: Callable[[sqlite3.Connection], Result]) -> Result:
        """Call ``work`` with the writing connection; its changes are on disk when this returns.

        On a full disk the reserve is released, a damaged file is replaced, and ``work`` is called once more. A file
        that another program has deleted, replaced or changed is written again first.

        Raises
        ------
        OutputError
            When the second call fails too; nothing has changed then.
        """
        with self._lock:
            if self._short and self._reserve.allocate():
                self._short = ""
                self._checkpoint_every(_PAGES)
            self._verify_file()
            try:
                return self._apply(work)
            except sqlite3.Error as error:
                self._repair(error)
            try:
                return self._apply(work)
            except sqlite3.Error as error:
                raise self._output_error(error) from error

    def verify(self) -> None:
        """Repair the database if another program has deleted, replaced or changed it; do nothing while it is written.

        Raises
        ------
        OutputError
            When it cannot be repaired.
        """
        if self._lock.acquire(blocking=False):
            try:
                self._verify_file()
            finally:
                self._lock.release()

    def save_totals(self) -> None:
        """Write the totals beside the database; a failure is ignored, because the database has them too."""
        with self._lock:
            self._saved_s = time.monotonic()
            try:
                write_snapshot(self._folder, self.sums)
            except OSError:
                return

    def used_bytes(self) -> int:
        """Return the used bytes of the database's file."""
        with self._lock:
            pages, unused, size = (
                self.connection.execute(f"PRAGMA {name}").fetchone()[0]
                for name in ("page_count", "freelist_count", "page_size")
            )
        return (pages - unused) * size

    def close(self) -> None:
        """Close the database; it can neither be written nor read afterwards."""
        with self._lock:
            self.save_totals()
            self.readers.close()
            self.connection.close()
            self._guard.close()

    def _open_database(self) -> OpenedDatabase:
        try:
            return open_or_recover(self._folder, self.shift_ns)
        except sqlite3.Error as error:
            if not (is_full(error) and self._reserve.release()):
                raise self._output_error(error) from error
        try:
            return open_or_recover(self._folder, self.shift_ns)
        except sqlite3.Error as error:
            raise self._output_error(error) from error

    def _use(self, opened: OpenedDatabase) -> None:
        self.connection, self.sums, self.message = opened.connection, opened.sums, opened.message
        self.last_number = opened.number
        self._watch = FileWatch(self.path, opened.connection)

    def _check_shift(self) -> None:
        """Raise SettingsError if days begin at another hour than in the database: they would be in two files."""
        (kept,) = self.connection.execute("SELECT shift_ns FROM ledger").fetchone()
        if kept is None:
            self.transact(lambda c: c.execute("UPDATE ledger SET shift_ns = ?", (self.shift_ns,)))
        elif kept != self.shift_ns:
            hour = kept / 3.6e12
            self.connection.close()
            raise SettingsError(
                f"{self.path}: its days begin at {hour:g} h UTC, day_begins_utc_h is "
                f"{self.shift_ns / 3.6e12:g}; set it to {hour:g} or begin a new data folder"
            )

    def _apply(self, work: Callable[[sqlite3.Connection], Result]) -> Result:
        try:
            return work(self.connection)
        finally:
            with suppress(sqlite3.Error):
                self._watch.remember()

    def _verify_file(self) -> None:
        """Repair what other programs did to the file, and describe it in ``message``; OutputError if impossible."""
        try:
            why = self._watch.find_replacement()
            if not why and self._watch.is_written_by_others():
                self.message = self._describe_foreign_write()
                self._watch.remember()
        except OSError as error:
            raise OutputError(
                f"{self.path}: cannot be read ({error.strerror or error}); correct its permissions"
            ) from error
        except sqlite3.Error as error:
            if is_temporary(error):
                raise self._output_error(error) from error
            why = f"another program changed it while the program ran ({error})"
        if why:
            self.readers.reset()
            self._use(rescue_database(self._folder, self.shift_ns, self.connection, self.sums, why))
            self.readers.reset()
            self.age += 1

    def _describe_foreign_write(self) -> str:
        """Return what another program's change left, after correcting the end; sqlite3.Error if it is unusable."""
        corrected = correct_end(self.connection, self.sums)
        count, newest = self.connection.execute("SELECT count(*), max(number) FROM records").fetchone()
        return (
            f"{self.path}: another program changed it while the program ran; it holds {count} records, the newest is "
            f"{newest} of {self.sums.number}; number, end and totals continue"
            + (" (its stored end was corrected)" if corrected else "")
        )

    def _repair(self, error: sqlite3.Error) -> None:
        """Remove the cause of an error so that a second attempt may succeed; OutputError if that is impossible."""
        if is_damage(error):
            self.connection.close()
            self.readers.reset()
            opened = replace_database(self._folder, self.shift_ns, self.sums, str(error))
            self._use(opened)
            self.age += 1
        elif is_full(error):
            self._short = "the disk is full" if "full" in str(error) else f"the disk fails ({error})"
            self._reserve.release()
            # the log is written to the database early, so that it does not use the space for the records
            self._checkpoint_every(_PAGES_SHORT)
            with suppress(sqlite3.Error):
                self.connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
        else:
            raise self._output_error(error) from error

    def _checkpoint_every(self, pages: int) -> None:
        self.connection.execute(f"PRAGMA wal_autocheckpoint = {pages}").fetchall()

    def _output_error(self, error: sqlite3.Error) -> OutputError:
        waits = "; what waits is stored then" if is_temporary(error) else ""
        return OutputError(f"{self.path}: not written: {describe_failure(self.path, error)}{waits}")


def _lock_folder(folder: Path) -> IO[bytes]:
    """Lock the folder for this process; the lock ends when the file is closed or the process ends."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        guard = (folder / "history.lock").open("ab")
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be written ({error.strerror or error}); correct its permissions"
        ) from error
    try:
        lock_file(guard.fileno())
    except OSError as error:
        guard.close()
        raise InputError(f"{folder}: another beltscape keeps its history here; stop it first") from error
    return guard
