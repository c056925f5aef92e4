"""Restoring a backup: checked as a whole beside its place, then put there by renaming; nothing is overwritten."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tomllib
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import IO

from beltscape.core.errors import InputError, OutputError
from beltscape.core.progress import Reporter
from beltscape.files.atomic import output_error, write_text
from beltscape.files.json_text import hash_file
from beltscape.pipeline.live.check import is_running
from beltscape.service.backup_archive import (
    DAMAGE,
    DATA,
    MANIFEST_FILE,
    PROJECT,
    BackupManifest,
    damage_error,
    find_form,
    read_archive,
    read_manifest,
)
from beltscape.sinks.historian.database import MIGRATIONS

_CHUNK = 1 << 20
"""Bytes that are copied at once."""
_DATA_KEY = re.compile(r"^[ \t]*data[ \t]*=.*$", re.MULTILINE)
"""The line of project.toml that names the data folder."""
_FIX = "take another backup"


@dataclass(frozen=True, slots=True)
class Restored:
    """Files that were restored, or that a check found sound."""

    manifest: BackupManifest
    project: Path
    data: Path
    moved_aside: tuple[Path, ...] = ()
    """Folders and files that were there before, under their new names."""

    @property
    def size_bytes(self) -> int:
        """Bytes of all files."""
        return sum(one.size for one in self.manifest.files.values())


@dataclass(slots=True)
class _Plan:
    """Places of the parts of a backup; each part is written beside its place first."""

    folder: Path
    data: Path
    staged: dict[Path, Path] = field(default_factory=dict[Path, Path])
    """Final place → path beside it, of folders and of single files."""
    present: set[str] = field(default_factory=set[str])
    """Files outside the project's folder that are there already as they were."""

    def add_place(self, place: Path) -> Path:
        """Return the path beside a place in which its content is written."""
        return self.staged.setdefault(place, place.with_name(f".{place.name}.{os.getpid()}.restore"))


def check_backup(backup: Path, reporter: Reporter) -> BackupManifest:
    """Return the manifest of a backup whose files are all there and sound; InputError with the file that is not."""
    with _open_backup(backup) as (manifest, files):
        _take(backup, manifest, files, lambda _: None, reporter)
    return manifest


def restore_backup(
    backup: Path, folder: Path, data: Path | None, reporter: Reporter, *, replace: bool
) -> Restored:
    """Restore a backup: the project's files into ``folder``, the others where they were; return what was restored.

    ``data`` is another place for the data folder, which project.toml then names. ``replace``: what is there
    already is renamed, not removed; without it a folder with files is refused.

    Raises
    ------
    InputError
        If the backup is damaged, with the name of the file, or a newer program made it.
    OutputError
        If something is there already, or cannot be written. Nothing has changed then.
    """
    with _open_backup(backup) as (manifest, files):
        plan = _make_plan(manifest, folder, data)
        _require_free(plan, manifest, replace=replace)
        try:
            _take(backup, manifest, files, lambda name: _locate(plan, manifest, name), reporter)
            if data is not None:
                _set_data(plan.add_place(folder) / manifest.project, data)
            moved = _exchange(plan)
        except OSError as error:
            raise output_error(Path(error.filename or folder), error) from error
        finally:
            _discard(plan)
    return Restored(manifest, folder / manifest.project, plan.data, moved)


@contextmanager
def _open_backup(backup: Path) -> Generator[tuple[BackupManifest, Iterator[tuple[str, IO[bytes], int]]]]:
    """Yield the manifest of a backup and its other files."""
    form = find_form(backup)
    with ExitStack() as opened:
        if form == "folder":
            if not (backup / MANIFEST_FILE).is_file():
                raise InputError(f"{backup}: has no {MANIFEST_FILE}; give a backup of beltscape backup")
            manifest = read_manifest(backup / MANIFEST_FILE, backup)
            yield _require_known(backup, manifest), _list_folder(backup, manifest)
            return
        files = opened.enter_context(read_archive(backup, form))
        name, content, _ = next(files, ("", None, 0))
        if name != MANIFEST_FILE or content is None:
            raise InputError(
                f"{backup}: does not begin with {MANIFEST_FILE}; give a backup of beltscape backup"
            )
        yield _require_known(backup, _read_first(backup, content, opened)), files


def _read_first(backup: Path, content: IO[bytes], opened: ExitStack) -> BackupManifest:
    from tempfile import TemporaryDirectory

    path = Path(opened.enter_context(TemporaryDirectory())) / MANIFEST_FILE
    path.write_bytes(_read(content, lambda error: damage_error(backup, MANIFEST_FILE, error)))
    return read_manifest(path, backup)


def _require_known(backup: Path, manifest: BackupManifest) -> BackupManifest:
    if manifest.schema > len(MIGRATIONS):
        raise InputError(
            f"{backup}: made by beltscape {manifest.program} with tables of version {manifest.schema}, this program "
            f"knows up to {len(MIGRATIONS)}; install beltscape {manifest.program} first"
        )
    return manifest


def _list_folder(backup: Path, manifest: BackupManifest) -> Iterator[tuple[str, IO[bytes], int]]:
    for name in manifest.files:
        path = backup / name
        if not path.is_file() or path.is_symlink():
            continue  # it is named as missing when all are through
        with path.open("rb") as content:
            yield name, content, path.stat().st_mode


def _make_plan(manifest: BackupManifest, folder: Path, data: Path | None) -> _Plan:
    place = folder / manifest.data if data is None else data
    plan = _Plan(folder.absolute(), place.absolute())
    plan.add_place(plan.folder)
    if not plan.data.is_relative_to(plan.folder):
        plan.add_place(plan.data)
    for name, outside in manifest.outside.items():
        path, entry = Path(outside), manifest.files.get(name)
        if entry is not None and path.is_file() and hash_file(path) == entry.sha256:
            plan.present.add(name)
    return plan


def _require_free(plan: _Plan, manifest: BackupManifest, *, replace: bool) -> None:
    """Raise OutputError if something is where the backup goes, or a run uses the data folder."""
    if is_running(plan.data):
        raise OutputError(f"{plan.data}: a run uses this data folder; stop it first")
    if replace:
        return
    outside = [Path(path) for name, path in manifest.outside.items() if name not in plan.present]
    for place in (*plan.staged, *outside):
        if (place.is_dir() and any(place.iterdir())) or (place.exists() and not place.is_dir()):
            raise OutputError(
                f"{place}: is there already; choose an empty folder, or --replace, which renames what is there"
            )


def _locate(plan: _Plan, manifest: BackupManifest, name: str) -> Path | None:
    """Return where a file of the backup is written first; None if it is in its place already."""
    kind, *rest = PurePosixPath(name).parts
    if kind == PROJECT:
        return plan.add_place(plan.folder).joinpath(*rest)
    if kind == DATA:
        if plan.data.is_relative_to(plan.folder):
            return plan.add_place(plan.folder) / plan.data.relative_to(plan.folder).joinpath(*rest)
        return plan.add_place(plan.data).joinpath(*rest)
    return None if name in plan.present else plan.add_place(Path(manifest.outside[name]))


def _take(
    backup: Path,
    manifest: BackupManifest,
    files: Iterator[tuple[str, IO[bytes], int]],
    locate: Callable[[str], Path | None],
    reporter: Reporter,
) -> None:
    """Compare every file of a backup with the manifest, and write it where ``locate`` says; None: nowhere."""
    missing = dict(manifest.files)
    for name, content, mode in files:
        entry = missing.pop(name, None)
        if entry is None:
            raise InputError(f"{backup}: {name} is not in its {MANIFEST_FILE}, or there twice; {_FIX}")
        size, digest = _copy(
            content, locate(name), mode, lambda error, at=name: damage_error(backup, at, error)
        )
        if (size, digest) != (entry.size, entry.sha256):
            raise InputError(
                f"{backup}: {name} is damaged: its SHA-256 is not that of the {MANIFEST_FILE}; {_FIX}"
            )
        reporter.step("reading backup", len(manifest.files) - len(missing), len(manifest.files))
    if missing:
        raise InputError(f"{backup}: {next(iter(missing))} is missing, of {len(missing)} files; {_FIX}")


def _copy(
    content: IO[bytes], target: Path | None, mode: int, describe: Callable[[Exception], InputError]
) -> tuple[int, str]:
    """Read a file, and write it to ``target``; return its length and SHA-256. ``describe`` names damage."""
    digest, size = hashlib.sha256(), 0
    with ExitStack() as opened:
        out: IO[bytes] | None = None
        if target is not None:
            target.parent.mkdir(parents=True, exist_ok=True)
            out = opened.enter_context(target.open("wb"))
            target.chmod(mode & 0o777)
        while chunk := _read(content, describe):
            digest.update(chunk)
            size += len(chunk)
            if out is not None:
                out.write(chunk)
        if out is not None:
            out.flush()
            os.fsync(out.fileno())
    return size, digest.hexdigest()


def _read(content: IO[bytes], describe: Callable[[Exception], InputError]) -> bytes:
    try:
        return content.read(_CHUNK)
    except DAMAGE as error:
        raise describe(error) from error


def _exchange(plan: _Plan) -> tuple[Path, ...]:
    """Rename what is there, and then the restored parts to their places; undo all if one cannot be renamed."""
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H%M%SZ")
    undo: list[tuple[Path, Path]] = []
    moved: list[Path] = []
    try:
        for place, staged in plan.staged.items():
            if not staged.exists():
                continue
            place.parent.mkdir(parents=True, exist_ok=True)
            if place.is_dir() and not any(place.iterdir()):
                place.rmdir()
            elif place.exists():
                aside = place.with_name(f"{place.name}.before-{stamp}")
                place.rename(aside)
                undo.append((aside, place))
                moved.append(aside)
            staged.rename(place)
            undo.append((place, staged))
    except OSError:
        for now, before in reversed(undo):
            now.rename(before)
        raise
    return tuple(moved)


def _discard(plan: _Plan) -> None:
    for staged in plan.staged.values():
        if staged.is_dir():
            shutil.rmtree(staged, ignore_errors=True)
        else:
            staged.unlink(missing_ok=True)


def _set_data(project: Path, data: Path) -> None:
    """Let project.toml name another data folder."""
    text = project.read_text("utf-8")
    head, table, rest = text.partition("\n[")
    line = f"data = {_quote(data)}"
    head = _DATA_KEY.sub(lambda _: line, head, count=1) if _DATA_KEY.search(head) else f"{line}\n{head}"
    if text.startswith("["):
        head, table, rest = line, "\n", text
    changed = head + table + rest
    if tomllib.loads(changed).get("data") != str(data.absolute()):
        raise OutputError(f"{project.name}: its line data = … cannot be changed; restore without --data")
    write_text(project, changed)


def _quote(path: Path) -> str:
    escaped = str(path.absolute()).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
