"""The one who writes: a lock, a connection, and what to do when the disk is full or the file is damaged."""

from __future__ import annotations

import fcntl
import sqlite3
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, TypeVar

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import InputError, OutputError, SettingsError
from beltscape.sinks.days import shift_ns_of
from beltscape.sinks.historian.storage.connections import Readers
from beltscape.sinks.historian.storage.failures import is_damage, is_full
from beltscape.sinks.historian.writing.ledger import append
from beltscape.sinks.historian.writing.recovery import (
    DATABASE,
    Opened,
    begin_anew,
    open_sound,
    write_snapshot,
)
from beltscape.sinks.historian.writing.reserve import Reserve
from beltscape.sinks.settings import HistorySettings

Result = TypeVar("Result")
_MIB = 1 << 20
_PAGES, _PAGES_SHORT = 1000, 40
"""Length of SQLite's log, pages, as it is by default and where the disk is full."""
_SNAPSHOT_S = 10.0
"""How often the totals are also written beside the database."""


class Store:
    """Changes to the history, one at a time, from any thread."""

    def __init__(self, folder: Path, settings: HistorySettings) -> None:
        """Open or make it; raises as ``Historian``."""
        self.path = folder / DATABASE
        self.shift_ns = shift_ns_of(settings.day_begins_utc_h)
        self._folder, self._settings = folder, settings
        self._lock = threading.RLock()
        self._guard = _claimed(folder)
        self._reserve = Reserve(folder / "reserve", settings.reserve_mib * _MIB)
        try:
            self._use(self._first_opened())
            self.age = 0
            self._short = ""
            self._check_shift()
        except BaseException:
            self._guard.close()
            raise
        self.readers = Readers(self.path)
        self._saved_s = float("-inf")
        if not self._reserve.make():
            self._short = "the disk is nearly full"

    @property
    def trouble(self) -> str:
        """Why less is kept than should be, in one line; empty where all is well."""
        if not self._short:
            return ""
        return (
            f"{self._folder}: {self._short}; records and totals go on in what was held back, without "
            f"cross-sections; free {2 * self._reserve.size_bytes // _MIB} MiB and all goes on by itself"
        )

    def write(self, records: Sequence[BeltRecord]) -> None:
        """Keep records; see ``Historian.write``."""

        def work(connection: sqlite3.Connection) -> None:
            wanted = self._settings.keep_sections and not self._short
            self.sums = append(connection, self.sums, records, self.shift_ns, sections=wanted)

        self.change(work)
        if time.monotonic() - self._saved_s >= _SNAPSHOT_S:
            self.save_totals()

    def change(self, work: Callable[[sqlite3.Connection], Result]) -> Result:
        """Do ``work`` with the writing connection; on disk when this returns.

        Where the disk is full the reserve is given up, where the file is damaged it is begun anew; ``work`` is done
        once more then.

        Raises
        ------
        OutputError
            When it cannot be written even so; nothing has changed then.
        """
        with self._lock:
            if self._short and self._reserve.make():
                self._short = ""
                self._checkpoint_every(_PAGES)
            try:
                return work(self.connection)
            except sqlite3.Error as error:
                self._mend(error)
            try:
                return work(self.connection)
            except sqlite3.Error as error:
                raise self._unwritable(error) from error

    def save_totals(self) -> None:
        """Write the totals beside the database; it has them too, so a disk that is full does no harm."""
        with self._lock:
            self._saved_s = time.monotonic()
            try:
                write_snapshot(self._folder, self.sums)
            except OSError:
                return

    def used_bytes(self) -> int:
        """What is in use of the database's file."""
        with self._lock:
            pages, unused, size = (
                self.connection.execute(f"PRAGMA {name}").fetchone()[0]
                for name in ("page_count", "freelist_count", "page_size")
            )
        return (pages - unused) * size

    def close(self) -> None:
        """Nothing more is written or read."""
        with self._lock:
            self.save_totals()
            self.readers.close()
            self.connection.close()
            self._guard.close()

    def _first_opened(self) -> Opened:
        try:
            return open_sound(self._folder, self.shift_ns)
        except sqlite3.Error as error:
            if not (is_full(error) and self._reserve.release()):
                raise self._unwritable(error) from error
        try:
            return open_sound(self._folder, self.shift_ns)
        except sqlite3.Error as error:
            raise self._unwritable(error) from error

    def _use(self, opened: Opened) -> None:
        self.connection, self.sums, self.message = opened.connection, opened.sums, opened.message
        self.known = opened.number

    def _check_shift(self) -> None:
        """Days that began at another hour would be in two files."""
        (kept,) = self.connection.execute("SELECT shift_ns FROM ledger").fetchone()
        if kept is None:
            self.change(lambda c: c.execute("UPDATE ledger SET shift_ns = ?", (self.shift_ns,)))
        elif kept != self.shift_ns:
            hour = kept / 3.6e12
            self.connection.close()
            raise SettingsError(
                f"{self.path}: its days begin at {hour:g} h UTC, day_begins_utc_h says "
                f"{self.shift_ns / 3.6e12:g}; set it to {hour:g} or begin a new data folder"
            )

    def _mend(self, error: sqlite3.Error) -> None:
        """Make a second try worth while, or OutputError."""
        if is_damage(error):
            self.connection.close()
            self.readers.renew()
            opened = begin_anew(self._folder, self.shift_ns, self.sums, str(error))
            self._use(opened)
            self.age += 1
        elif is_full(error):
            self._short = "the disk is full" if "full" in str(error) else f"the disk fails ({error})"
            self._reserve.release()
            # the log goes into the database early and begins anew: it must not take what the records need
            self._checkpoint_every(_PAGES_SHORT)
            with suppress(sqlite3.Error):
                self.connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
        else:
            raise self._unwritable(error) from error

    def _checkpoint_every(self, pages: int) -> None:
        self.connection.execute(f"PRAGMA wal_autocheckpoint = {pages}").fetchall()

    def _unwritable(self, error: sqlite3.Error) -> OutputError:
        return OutputError(f"{self.path}: cannot be written ({error}); free some space or mend its rights")


def _claimed(folder: Path) -> IO[bytes]:
    """The folder for this process alone; given back when the file is closed or the process ends, however it does."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        guard = (folder / "history.lock").open("ab")
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be written ({error.strerror or error}); mend its rights"
        ) from error
    try:
        fcntl.flock(guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        guard.close()
        raise InputError(f"{folder}: another beltscape keeps its history here; stop it first") from error
    return guard
