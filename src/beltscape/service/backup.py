"""Making a backup of a running plant: consistent copies of its databases, and all files with their SHA-256.

It holds the data folder without recordings, and every file that project.toml names.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from beltscape import __version__
from beltscape.core.errors import InputError, OutputError
from beltscape.core.progress import Reporter
from beltscape.core.system_calls import sync_files
from beltscape.files.atomic import output_error
from beltscape.files.json_text import hash_file
from beltscape.files.sqlite_failures import describe_failure, is_damage, is_full
from beltscape.pipeline.live.project import Project, read_project
from beltscape.service.backup_archive import (
    DATA,
    FORMS,
    OUTSIDE,
    PROJECT,
    BackupEntry,
    BackupManifest,
    Form,
    write_archive,
    write_manifest,
)
from beltscape.service.changes import NO_SETTINGS, list_values
from beltscape.service.project import ProjectSettings
from beltscape.sinks.historian.database import MIGRATIONS
from beltscape.sinks.historian.recovery import DATABASE

_EXCLUDED = frozenset({"recordings", "reserve", "before_update"})
"""Parts of the data folder that are too large, or useless on another machine."""
_EXCLUDED_ENDINGS = (".db", ".db-wal", ".db-shm", ".db-journal", ".lock", ".part", ".request")
"""Databases are copied by themselves; the others belong to a running program."""
_COPIED_FIRST = "totals.json"
"""Copied before the database, so that it is never newer and a restored history is complete."""


@dataclass(frozen=True, slots=True)
class BackupFile:
    """A file to be backed up."""

    name: str
    """In the backup, with slashes."""
    path: Path
    is_database: bool = False


def list_data(data: Path) -> Iterator[BackupFile]:
    """Yield the files of the data folder: the totals, the databases, then the others.

    Day files follow the databases, so that records that are moved meanwhile are not lost.
    """
    if (data / _COPIED_FIRST).is_file():
        yield BackupFile(f"{DATA}/{_COPIED_FIRST}", data / _COPIED_FIRST)
    for path in sorted(data.glob("*.db")):
        yield BackupFile(f"{DATA}/{path.name}", path, is_database=True)
    for path in _walk_files(data):
        place = path.relative_to(data)
        is_kept = place.parts[0] not in _EXCLUDED and str(place) != _COPIED_FIRST
        if is_kept and not path.name.endswith(_EXCLUDED_ENDINGS):
            yield BackupFile(f"{DATA}/{place.as_posix()}", path)


def list_settings(
    project: Project[ProjectSettings], reporter: Reporter
) -> Iterator[tuple[BackupFile, Path | None]]:
    """Yield project.toml and the files that it names, each with its absolute path where it lies elsewhere."""
    yield BackupFile(f"{PROJECT}/{project.path.name}", project.path), None
    root, seen = project.path.parent.resolve(), {project.path.resolve()}
    data = project.resolve(project.settings.data).resolve()
    for key, value in list_values(project.settings):
        if not isinstance(value, Path) or key in NO_SETTINGS:
            continue
        named = _list_named(project.resolve(value))
        if not named:
            reporter.warn(
                f"{project.resolve(value)}: there is no such file; {key} names it, and the backup lacks it"
            )
        for path in named:
            if path.resolve() in seen:
                continue
            seen.add(path.resolve())
            place = path.parent.resolve() / path.name
            if place.is_relative_to(data):
                continue
            if place.is_relative_to(root):
                yield BackupFile(f"{PROJECT}/{place.relative_to(root).as_posix()}", path), None
            else:
                yield BackupFile(f"{OUTSIDE}/{len(seen)}/{place.name}", path), place


def _list_named(path: Path) -> list[Path]:
    """Return a file, or the files of a folder; nothing where there is none."""
    return [path] if path.is_file() else list(_walk_files(path)) if path.is_dir() else []


def _walk_files(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink():
            yield path


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
    files: dict[str, BackupEntry] = {}
    for number, source in enumerate(sources, 1):
        copy = part / source.name
        if _copy(source, copy):
            files[source.name] = BackupEntry(copy.stat().st_size, hash_file(copy))
        reporter.step("backing up", number, len(sources))
    manifest = BackupManifest(
        now.isoformat(timespec="seconds"),
        __version__,
        len(MIGRATIONS),
        project.path.name,
        str(project.settings.data),
        {source.name: str(place) for source, place in settings if source.name.startswith(OUTSIDE)},
        files,
    )
    write_manifest(part, manifest)


def _copy(source: BackupFile, target: Path) -> bool:
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
