"""Making a backup of a running plant: consistent copies of its databases, and all files with their SHA-256."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from beltscape import __version__
from beltscape.core.errors import InputError, OutputError
from beltscape.core.progress import Reporter
from beltscape.core.runtime.system_calls import sync_files
from beltscape.files.documents.digest import hash_file
from beltscape.files.folders.atomic import output_error
from beltscape.files.sqlite_failures import describe_failure, is_damage, is_full
from beltscape.pipeline.live.project import Project, read_project
from beltscape.service.backup.archive import FORMS, Form, write_archive
from beltscape.service.backup.contents import Source, list_data, list_settings
from beltscape.service.backup.manifest import OUTSIDE, Entry, Manifest, write_manifest
from beltscape.service.project import ProjectSettings
from beltscape.sinks.historian.storage.schema import MIGRATIONS
from beltscape.sinks.historian.writing.recovery import DATABASE

_PATIENCE_S = 60.0
"""Longest wait for a database that another program writes."""
_NAME = "%Y-%m-%dT%H%M%SZ"
"""Name of a backup, UTC; they sort by age."""


def make_backup(path: Path, target: Path, form: Form, keep: int | None, reporter: Reporter) -> Path:
    """Back up the plant of a project.toml into a new folder or archive below ``target``; return its path.

    It gets its name only when it is whole and on the disk. ``keep`` is the number of backups that stay; None: all.

    Raises
    ------
    InputError
        If a file cannot be read or a database is damaged.
    OutputError
        If the backup cannot be written; then nothing of it is left.
    """
    project = read_project(path, ProjectSettings)
    data = project.resolve(project.settings.data)
    if not (data / DATABASE).is_file():
        raise InputError(f"{data}: has no {DATABASE}; there is nothing to back up before the first run")
    now = datetime.now(UTC)
    part = target / f".{now.strftime(_NAME)}.part"
    final = target / f"{now.strftime(_NAME)}{'' if form == 'folder' else f'.{form}'}"
    if final.exists():
        raise OutputError(f"{final}: is there already; wait a second")
    try:
        part.mkdir(parents=True, mode=0o700)
        _fill(project, data, part, now, reporter)
        _finish(part, final, form)
        if keep is not None:
            _prune(target, max(1, keep))
    except OSError as error:
        raise output_error(final, error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return final


def _fill(
    project: Project[ProjectSettings], data: Path, part: Path, now: datetime, reporter: Reporter
) -> None:
    settings = list(list_settings(project, reporter))
    sources = [*list_data(data), *(source for source, _ in settings)]
    files: dict[str, Entry] = {}
    for number, source in enumerate(sources, 1):
        copy = part / source.name
        if _copy(source, copy):
            files[source.name] = Entry(copy.stat().st_size, hash_file(copy))
        reporter.step("backing up", number, len(sources))
    manifest = Manifest(
        now.isoformat(timespec="seconds"),
        __version__,
        len(MIGRATIONS),
        project.path.name,
        str(project.settings.data),
        {source.name: str(place) for source, place in settings if source.name.startswith(OUTSIDE)},
        files,
    )
    write_manifest(part, manifest)


def _copy(source: Source, target: Path) -> bool:
    """Copy a file; return False if the retention deleted it meanwhile."""
    target.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    try:
        if source.is_database:
            copy_database(source.path, target)
        else:
            shutil.copy2(source.path, target)
    except FileNotFoundError:
        return False
    except PermissionError as error:
        raise InputError(f"{source.path}: cannot be read; run the backup as the service's user") from error
    return True


def copy_database(source: Path, target: Path) -> None:
    """Copy a consistent state of a database that may be written meanwhile, with its rights, and check it.

    Raises
    ------
    InputError
        If it is damaged.
    """
    mode = source.stat().st_mode & 0o777
    target.touch(mode=0o600)
    target.chmod(mode)  # before it holds anything: that of the users is for nobody else
    try:
        with (
            closing(sqlite3.connect(source, timeout=_PATIENCE_S)) as original,
            closing(sqlite3.connect(target)) as copy,
        ):
            original.backup(copy)  # in one step: a backup by pages would restart with every new record
            copy.execute("PRAGMA journal_mode=DELETE")
            (answer,) = copy.execute("PRAGMA quick_check(1)").fetchone()
    except sqlite3.Error as error:
        if is_full(error):
            raise OutputError(f"{target}: not written: {describe_failure(target, error)}") from error
        fix = "; a run repairs its history" if is_damage(error) else ""
        reason = describe_failure(source, error)
        raise InputError(f"{source}: cannot be backed up: {reason}{fix}") from error
    if answer != "ok":
        raise InputError(f"{source}: is damaged ({' '.join(answer.split())}); a run repairs its history")


def _finish(part: Path, final: Path, form: Form) -> None:
    """Give the backup its name once it is on the disk."""
    if form == "folder":
        sync_files()
        part.rename(final)
        return
    unfinished = part.with_suffix(f".part.{form}")
    try:
        write_archive(part, unfinished, form)
        unfinished.chmod(0o600)
        sync_files()
        unfinished.rename(final)
    finally:
        unfinished.unlink(missing_ok=True)


def _prune(target: Path, keep: int) -> None:
    """Remove the oldest backups; other files of the folder stay."""
    backups = sorted((one for one in target.iterdir() if _is_backup(one)), key=lambda one: one.name)
    for old in backups[:-keep]:
        shutil.rmtree(old) if old.is_dir() else old.unlink()


def _is_backup(path: Path) -> bool:
    name = path.name
    for form in FORMS[1:]:
        name = name.removesuffix(f".{form}")
    try:
        datetime.strptime(name, _NAME)
    except ValueError:
        return False
    return True
