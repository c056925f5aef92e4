#!/usr/bin/env python3
"""Back up the data folder of a running beltscape, and its settings.

Writes TARGET/<UTC time>/ and keeps the newest backups. Databases are copied by SQLite's backup API, which gives a
consistent state while the program continues to write, and are checked afterwards. All other files except recordings
are copied as they are. A backup folder gets its name only when it is complete on disk. Needs only Python 3.11.
"""

import argparse
import os
import shutil
import sqlite3
import sys
from datetime import UTC, datetime
from pathlib import Path

EXCLUDED = {"recordings", "reserve"}
"""Too large, or useless on another machine."""
EXCLUDED_ENDINGS = (".db", ".db-wal", ".db-shm", ".db-journal", ".lock", ".part")
COPIED_FIRST = "totals.json"
"""Copied before the database, so that it is never newer and a restored history is complete."""


def main(arguments):
    """Make a backup; return exit status 0, or 1 with one line if that fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="data folder of project.toml")
    parser.add_argument("target", type=Path, help="folder of the backups")
    parser.add_argument("--settings", type=Path, help="folder of project.toml, rig.json, belt.json")
    parser.add_argument("--keep", type=int, default=14, help="number of backups to keep (14)")
    options = parser.parse_args(arguments)
    if not (options.data / "history.db").is_file():
        return _report_failure(f"{options.data}: no history.db there; give the data folder of project.toml")
    name = datetime.now(UTC).strftime("%Y-%m-%dT%H%M%SZ")
    part = options.target / f".{name}.part"
    try:
        part.mkdir(parents=True, mode=0o700)
        copy_data(options.data, part / "data")
        if options.settings is not None:
            shutil.copytree(options.settings, part / "settings", ignore=shutil.ignore_patterns("data"))
        os.sync()
        part.rename(options.target / name)
        _prune(options.target, max(1, options.keep))
    except (OSError, sqlite3.Error) as error:
        shutil.rmtree(part, ignore_errors=True)
        return _report_failure(f"{options.target}: no backup was made ({error}); check space and rights")
    print(options.target / name)
    return 0


def copy_data(source, target):
    """Copy the data folder. Day files follow the databases, so that records moved meanwhile are not lost."""
    target.mkdir()
    if (source / COPIED_FIRST).is_file():
        shutil.copy2(source / COPIED_FIRST, target / COPIED_FIRST)
    for path in sorted(source.glob("*.db")):
        _copy_database(path, target / path.name)
    for path in sorted(source.rglob("*")):
        place = path.relative_to(source)
        if (
            place.parts[0] in EXCLUDED
            or str(place) == COPIED_FIRST
            or path.is_symlink()
            or path.name.endswith(EXCLUDED_ENDINGS)
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
        return  # deleted meanwhile by the retention


def _copy_database(source, target):
    """Copy a consistent state of a database and check it."""
    original, copy = sqlite3.connect(source, timeout=60), sqlite3.connect(target)
    try:
        original.backup(copy)  # in one step: a backup by pages would restart with every new record
        copy.execute("PRAGMA journal_mode=DELETE")
        (answer,) = copy.execute("PRAGMA quick_check(1)").fetchone()
        if answer != "ok":
            raise sqlite3.DatabaseError(f"{source}: {answer}")
    finally:
        copy.close()
        original.close()


def _prune(target, keep):
    backups = sorted(one for one in target.iterdir() if one.is_dir() and not one.name.startswith("."))
    for old in backups[:-keep]:
        shutil.rmtree(old)


def _report_failure(line):
    print(line, file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
