"""Output folders that a command owns: it replaces its earlier files, keeps foreign ones, refuses foreign folders.

A command writes into a staging folder inside its output folder. Only after its success the files move to their
places, and files of its earlier run that it did not write again are removed. Meanwhile the manifest is marked
incomplete, so that a reader never takes a mixture of two runs for a result.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from beltscape import __version__
from beltscape.core.errors import OutputError
from beltscape.core.runtime.system_calls import lock_folder
from beltscape.files.folders.atomic import output_error, write_bytes
from beltscape.files.folders.manifest import (
    MANIFEST,
    STAGING,
    Manifest,
    files_below,
    read_manifest,
    write_manifest,
)
from beltscape.files.folders.paths import summarise_names

_TRACES = ("rig.json", "calibration.json", "plan.json", "volume.json", "lumps.json", "flow.json", "features.json",
           "pattern.json", "paper.json", "board.toml", "truth/scenario.json", "*/depth.tiff",
           "*/rectification.json", "calibration/rig.json")  # fmt: skip
"""Files that identify output of a Beltscape version without manifests."""


@contextmanager
def owned_folder(out: Path, command: str) -> Generator[Path]:
    """Yield an empty staging folder whose files become those of ``out`` on success; a failure changes nothing.

    Raises
    ------
    OutputError
        When ``out`` holds what ``command`` did not write, cannot be written to, or is being written by another run.
    """
    refuse_foreign(out, command)
    staging = out / STAGING
    with _locked_folder(out):
        try:
            shutil.rmtree(staging, ignore_errors=True)
            try:
                staging.mkdir()
            except OSError as error:
                raise output_error(out, error) from error
            yield staging
            _swap(staging, out, command)
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def add_file(out: Path, command: str, name: str, data: bytes) -> Path:
    """Write one file into ``out`` beside what ``command`` wrote there, which stays; return its path.

    For what explains a failure: the next success of ``command`` removes it.
    """
    write_bytes(out / name, data)
    files = tuple(sorted({*_own_files(out), name}))
    write_manifest(out, Manifest(command, __version__, complete=True, files=files))
    return out / name


@contextmanager
def continued_folder(out: Path, command: str) -> Generator[Path]:
    """Yield ``out`` itself, for a command that continues its own earlier files; a failure leaves no new folder.

    Raises
    ------
    OutputError
        As :func:`owned_folder`.
    """
    refuse_foreign(out, command)
    foreign = set(files_below(out)) - set(_own_files(out))
    with _locked_folder(out):
        try:
            write_manifest(out, Manifest(command, __version__, complete=True, files=_own_files(out)))
            yield out
        finally:
            own = tuple(name for name in files_below(out) if name not in foreign)
            if own:
                write_manifest(out, Manifest(command, __version__, complete=True, files=own))
            else:
                (out / MANIFEST).unlink(missing_ok=True)


def refuse_foreign(out: Path, command: str) -> None:
    """Raise OutputError, with the content and the fix, if ``out`` holds files that ``command`` did not write."""
    if not out.is_dir():
        return
    manifest = read_manifest(out)
    if manifest is not None and manifest.command == command:
        return
    where = f"{out} (the working folder)" if str(out) == "." else str(out)
    if manifest is not None:
        raise OutputError(
            f"{where}: holds what beltscape {manifest.command} wrote; choose another --out for beltscape "
            f"{command}, or remove the folder"
        )
    names = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
    if not names:
        return
    held = summarise_names(names, most=3)
    if any(next(out.glob(trace), None) for trace in _TRACES):
        raise OutputError(
            f"{where}: holds {held}, written without a manifest, as by an earlier version of Beltscape, "
            f"or copied there; choose another --out, or remove the folder"
        )
    raise OutputError(
        f"{where}: holds {held}, which beltscape {command} did not write; choose a new or empty --out"
    )


def _own_files(out: Path) -> tuple[str, ...]:
    manifest = read_manifest(out)
    return () if manifest is None else manifest.files


@contextmanager
def _locked_folder(out: Path) -> Generator[None]:
    """Create ``out`` and lock it; folders created for it that stay empty are removed afterwards."""
    made = _missing_folders(out)
    lock = None
    try:
        try:
            out.mkdir(parents=True, exist_ok=True)
            lock = _lock(out)
        except OSError as error:
            raise output_error(out, error) from error
        yield
    finally:
        if lock is not None:
            os.close(lock)
        _remove_empty(made)


def _missing_folders(out: Path) -> list[Path]:
    """Return the folders that must be created for ``out``, the innermost first."""
    return [path for path in (out, *out.parents) if not path.exists()]


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


def _lock(out: Path) -> int:
    """Return the open folder, locked until it is closed or the process ends; OutputError if it is locked already."""
    try:
        return lock_folder(out)
    except BlockingIOError as error:
        raise OutputError(f"{out}: another beltscape command is writing there; wait for it") from error


def _swap(staging: Path, out: Path, command: str) -> None:
    """Move the staged files to their places and remove those of the earlier run that were not written again."""
    new, old = files_below(staging), _own_files(out)
    taken = [name for name in new if name not in set(old) and os.path.lexists(out / name)]
    if taken:
        raise OutputError(
            f"{out / taken[0]}: lies where beltscape {command} writes, and it did not write it; "
            "move it elsewhere and run again"
        )
    write_manifest(out, Manifest(command, __version__, complete=False, files=tuple(sorted({*old, *new}))))
    try:
        for name in set(old) - set(new):
            (out / name).unlink(missing_ok=True)
        for folder in sorted({parent for name in old for parent in Path(name).parents}, reverse=True):
            if folder != Path() and (out / folder).is_dir() and not any((out / folder).iterdir()):
                (out / folder).rmdir()
        for name in new:
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (staging / name).replace(out / name)
    except OSError as error:
        raise output_error(Path(error.filename or out), error) from error
    write_manifest(out, Manifest(command, __version__, complete=True, files=new))
