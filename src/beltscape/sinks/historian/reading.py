"""Reading of a history beside its writer: without a lock or a trace, also while a running plant writes it."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import TypeVar

from beltscape.core.errors import InputError
from beltscape.sinks.historian.database import MIGRATIONS, open_reader, require_known
from beltscape.sinks.historian.recovery import DATABASE

HISTORY = "history"
"""Sub-folder of a re-processing's store with its history."""
_TRIES = 3
"""Readings of a database that a starting or ending run changes meanwhile. Chosen."""
_DAMAGE = (sqlite3.Error, ValueError, TypeError, IndexError, KeyError, OverflowError)
"""What values of another kind than the tables' raise."""

Content = TypeVar("Content")


class ChangedMeanwhileError(Exception):
    """Another process has begun to write the database."""


def find_database(folder: Path) -> Path:
    """Return the database of the history in ``folder``, or in its sub-folder ``history``; InputError without one."""
    if not folder.is_dir():
        what = "is no folder" if folder.exists() else "does not exist"
        raise InputError(
            f"{folder}: {what}; give the data folder of a run or replay, or a re-processing's store"
        )
    for path in (folder / DATABASE, folder / HISTORY / DATABASE):
        if path.is_file():
            return path
    raise InputError(
        f"{folder}: has no {DATABASE} and no {HISTORY}/{DATABASE}; give the data folder of a run or replay, "
        "or a re-processing's store"
    )


def read_history(path: Path, read: Callable[[sqlite3.Connection], Content]) -> Content:
    """Return what ``read`` returns for one consistent view of the database at ``path``.

    Raises
    ------
    InputError
        If it is damaged, its tables are of another version, or it is started and stopped meanwhile again and again.
    """
    for attempt in range(_TRIES):
        try:
            with open_history(path) as connection:
                require_present_version(connection, path)
                return read(connection)
        except ChangedMeanwhileError:
            continue
        except _DAMAGE as error:
            if attempt + 1 < _TRIES and _beside(path, "wal").exists():
                continue  # a run has started while it was read
            reason = " ".join(str(error).split())
            raise InputError(
                f"{path}: cannot be read ({reason}); restore it from a backup, or let a run repair it"
            ) from error
    raise InputError(f"{path}: is started and stopped while it is read; try again once it runs or rests")


def _beside(path: Path, ending: str) -> Path:
    """Return the path of a database's log (``wal``) or of the log's index (``shm``)."""
    return path.with_name(f"{path.name}-{ending}")


def _copy(path: Path, folder: Path) -> Path:
    for source in (path, _beside(path, "wal")):
        copyfile(source, folder / source.name)
    return folder / path.name


@contextmanager
def open_history(path: Path) -> Generator[sqlite3.Connection]:
    """Yield a connection with one consistent view.

    A database that nobody has open has no log; it is opened as immutable, because a usual reader would leave an empty
    log behind. A database with a log is read beside its writer, as a backup reads it. A log without an index has no
    writer (it was copied so); then a copy of both is read.
    """
    if _beside(path, "wal").exists():
        with TemporaryDirectory() as folder:
            read = path if _beside(path, "shm").exists() else _copy(path, Path(folder))
            with closing(open_reader(read)) as connection:
                connection.execute("BEGIN")
                yield connection
        return
    before = path.stat()
    address = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    with closing(sqlite3.connect(address, uri=True, isolation_level=None)) as connection:
        yield connection
    after = path.stat()
    if _beside(path, "wal").exists() or (before.st_mtime_ns, before.st_size) != (
        after.st_mtime_ns,
        after.st_size,
    ):
        raise ChangedMeanwhileError


def require_sound(connection: sqlite3.Connection, path: Path) -> None:
    """Raise InputError if SQLite finds damage in the structure of the file; it reads all of it."""
    (answer,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if answer != "ok":
        raise InputError(
            f"{path}: is damaged ({' '.join(answer.split())}); restore it from a backup, or let a run repair it"
        )


def require_present_version(connection: sqlite3.Connection, path: Path) -> None:
    """Raise InputError unless the tables are those of this program."""
    version = require_known(connection, path)
    if version == 0:
        raise InputError(f"{path}: has no tables of a history; give the data folder of a run or replay")
    if version < len(MIGRATIONS):
        raise InputError(
            f"{path}: its tables are of version {version}, this program reads {len(MIGRATIONS)}; a run of this "
            "program updates them: start it once, or give a copy that it has updated"
        )
