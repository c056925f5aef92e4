"""The contents of a backup: the data folder without recordings, and every file that project.toml names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.progress import Reporter
from beltscape.pipeline.live.project import Project
from beltscape.service.backup.manifest import DATA, OUTSIDE, PROJECT
from beltscape.service.changes.differences import NO_SETTINGS, list_values
from beltscape.service.project import ProjectSettings

_EXCLUDED = frozenset({"recordings", "reserve", "before_update"})
"""Parts of the data folder that are too large, or useless on another machine."""
_EXCLUDED_ENDINGS = (".db", ".db-wal", ".db-shm", ".db-journal", ".lock", ".part", ".request")
"""Databases are copied by themselves; the others belong to a running program."""
_COPIED_FIRST = "totals.json"
"""Copied before the database, so that it is never newer and a restored history is complete."""


@dataclass(frozen=True, slots=True)
class Source:
    """A file to be backed up."""

    name: str
    """In the backup, with slashes."""
    path: Path
    is_database: bool = False


def list_data(data: Path) -> Iterator[Source]:
    """Yield the files of the data folder: the totals, the databases, then the others.

    Day files follow the databases, so that records that are moved meanwhile are not lost.
    """
    if (data / _COPIED_FIRST).is_file():
        yield Source(f"{DATA}/{_COPIED_FIRST}", data / _COPIED_FIRST)
    for path in sorted(data.glob("*.db")):
        yield Source(f"{DATA}/{path.name}", path, is_database=True)
    for path in _walk_files(data):
        place = path.relative_to(data)
        is_kept = place.parts[0] not in _EXCLUDED and str(place) != _COPIED_FIRST
        if is_kept and not path.name.endswith(_EXCLUDED_ENDINGS):
            yield Source(f"{DATA}/{place.as_posix()}", path)


def list_settings(
    project: Project[ProjectSettings], reporter: Reporter
) -> Iterator[tuple[Source, Path | None]]:
    """Yield project.toml and the files that it names, each with its absolute path where it lies elsewhere."""
    yield Source(f"{PROJECT}/{project.path.name}", project.path), None
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
                yield Source(f"{PROJECT}/{place.relative_to(root).as_posix()}", path), None
            else:
                yield Source(f"{OUTSIDE}/{len(seen)}/{place.name}", path), place


def _list_named(path: Path) -> list[Path]:
    """Return a file, or the files of a folder; nothing where there is none."""
    return [path] if path.is_file() else list(_walk_files(path)) if path.is_dir() else []


def _walk_files(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink():
            yield path
