#!/usr/bin/env python3
"""Back up the data folder of a running beltscape, and its settings.

Writes TARGET/<UTC time>/ and keeps the newest of them. Databases are copied by SQLite's own backup, each a moment's
whole state while the program goes on writing, and read back; all else is copied as it is, but for recordings.
Nothing is left half done: a folder gets its name when all of it is on disk. Needs Python 3.11 and nothing else.
"""

import argparse
import os
import shutil
import sqlite3
import sys
from datetime import UTC, datetime
from pathlib import Path

LEFT_OUT = {"recordings", "reserve"}
"""Large, or worth nothing elsewhere."""
NO_FILES = (".db", ".db-wal", ".db-shm", ".db-journal", ".lock", ".part")
FIRST = "totals.json"
"""Never newer than the database, so that a restored history is whole."""


def main(arguments):
    """Exit status 0; 1 with one line where the backup could not be made."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="data folder of project.toml")
    parser.add_argument("target", type=Path, help="folder of the backups")
    parser.add_argument("--settings", type=Path, help="folder of project.toml, rig.json, belt.json")
    parser.add_argument("--keep", type=int, default=14, help="how many backups are kept (14)")
    asked = parser.parse_args(arguments)
    if not (asked.data / "history.db").is_file():
        return _failed(f"{asked.data}: no history.db there; give the data folder of project.toml")
    name = datetime.now(UTC).strftime("%Y-%m-%dT%H%M%SZ")
    part = asked.target / f".{name}.part"
    try:
        part.mkdir(parents=True, mode=0o700)
        copy_data(asked.data, part / "data")
        if asked.settings is not None:
            shutil.copytree(asked.settings, part / "settings", ignore=shutil.ignore_patterns("data"))
        os.sync()
        part.rename(asked.target / name)
        _prune(asked.target, max(1, asked.keep))
    except (OSError, sqlite3.Error) as error:
        shutil.rmtree(part, ignore_errors=True)
        return _failed(f"{asked.target}: no backup was made ({error}); check space and rights")
    print(asked.target / name)
    return 0


def copy_data(source, target):
    """The data folder. Day files come after the databases: what those hand on meanwhile, these hold."""
    target.mkdir()
    if (source / FIRST).is_file():
        shutil.copy2(source / FIRST, target / FIRST)
    for path in sorted(source.glob("*.db")):
        _copy_database(path, target / path.name)
    for path in sorted(source.rglob("*")):
        place = path.relative_to(source)
        if (
            place.parts[0] in LEFT_OUT
            or str(place) == FIRST
            or path.is_symlink()
            or path.name.endswith(NO_FILES)
        ):
            continue
        if path.is_dir():
            (target / place).mkdir(exist_ok=True)
        elif path.is_file():
            _copy_file(path, target / place)


def _copy_file(path, target):
    try:
        shutil.copy2(path, target)
    except FileNotFoundError:
        return  # its time was over meanwhile


def _copy_database(source, target):
    """One whole state, read back."""
    held, copy = sqlite3.connect(source, timeout=60), sqlite3.connect(target)
    try:
        held.backup(copy)  # in one go: done by pages it would begin again with every record
        copy.execute("PRAGMA journal_mode=DELETE")
        (answer,) = copy.execute("PRAGMA quick_check(1)").fetchone()
        if answer != "ok":
            raise sqlite3.DatabaseError(f"{source}: {answer}")
    finally:
        copy.close()
        held.close()


def _prune(target, keep):
    done = sorted(one for one in target.iterdir() if one.is_dir() and not one.name.startswith("."))
    for old in done[:-keep]:
        shutil.rmtree(old)


def _failed(line):
    print(line, file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
