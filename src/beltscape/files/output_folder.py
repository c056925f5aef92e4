"""Output folders that a command owns: it replaces its earlier files, keeps foreign ones, refuses foreign folders.

A command writes into a staging folder inside its output folder. Only after its success the files move to their
places, and files of its earlier run that it did not write again are removed. The folder's manifest names the
command and its files; meanwhile it is marked incomplete, so that a reader never takes a mixture of two runs for a
result.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from beltscape import __version__
from beltscape.core.errors import InputError, OutputError
from beltscape.core.system_calls import lock_folder
from beltscape.files.atomic import output_error, write_bytes, write_text
from beltscape.files.paths import summarise_names

MANIFEST = ".beltscape.json"
"""Name of the manifest in an output folder."""
STAGING = ".beltscape-partial"
"""Folder in an output folder in which a command writes until it has finished."""
_FORMAT = "beltscape-output/1"


@dataclass(frozen=True, slots=True)
class OutputManifest:
    """Description of a command's output in its folder."""

    command: str
    """Name of the command as on the command line, such as ``measure volume``."""
    version: str
    """Version of Beltscape."""
    complete: bool
    """False while files are being replaced: an interrupted command leaves it so."""
    files: tuple[str, ...]
    """Relative to the folder, with slashes, sorted."""


def read_manifest(folder: Path) -> OutputManifest | None:
    """Return the manifest of ``folder``, None where it has none; OutputError where it is damaged."""
    path = folder / MANIFEST
    try:
        return parse_manifest(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise OutputError(
            f"{path}: is no manifest of this version of Beltscape; choose another folder, or remove {folder}"
        ) from error


def parse_manifest(data: bytes) -> OutputManifest:
    """Return the manifest in the bytes of its file; ValueError where it is damaged."""
    try:
        document = json.loads(data)
        if document["format"] != _FORMAT or not all(isinstance(name, str) for name in document["files"]):
            raise ValueError(document["format"])
        return OutputManifest(
            str(document["command"]),
            str(document["version"]),
            bool(document["complete"]),
            tuple(document["files"]),
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"no manifest: {error!r}") from error


def write_manifest(folder: Path, manifest: OutputManifest) -> None:
    """Write the manifest of ``folder``, atomically."""
    text = json.dumps({"format": _FORMAT, **asdict(manifest)}, indent=1, ensure_ascii=False)
    write_text(folder / MANIFEST, text + "\n")


def files_below(folder: Path, leave: Iterable[str] = ()) -> tuple[str, ...]:
    """Return every file below ``folder``, relative and sorted, except those whose first part is in ``leave``."""
    skipped = {MANIFEST, STAGING, *leave}
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    return tuple(sorted(path.as_posix() for path in paths if path.parts[0] not in skipped))


def require_finished(folder: Path) -> None:
    """Raise InputError if the command that writes ``folder`` was interrupted or still runs.

    A folder without a manifest was copied or made otherwise, and is accepted.
    """
    try:
        manifest = read_manifest(folder)
    except OutputError:
        return  # only commands that write there must refuse it
    reason = describe_unfinished(manifest, is_staged=(folder / STAGING).is_dir())
    if reason:
        raise InputError(f"{folder}: {reason}")


def describe_unfinished(manifest: OutputManifest | None, *, is_staged: bool) -> str:
    """Return why a folder is not finished, with the fix; empty if it is. ``is_staged``: it holds `STAGING`."""
    if manifest is None and is_staged:
        return (
            "the command that writes it was interrupted or still runs; "
            "wait for it, or run it again with the same --out"
        )
    if manifest is not None and not manifest.complete:
        return f"beltscape {manifest.command} was interrupted while it wrote this folder; run it again"
    return ""


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
    write_manifest(out, OutputManifest(command, __version__, complete=True, files=files))
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
            write_manifest(out, OutputManifest(command, __version__, complete=True, files=_own_files(out)))
            yield out
        finally:
            own = tuple(name for name in files_below(out) if name not in foreign)
            if own:
                write_manifest(out, OutputManifest(command, __version__, complete=True, files=own))
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
    write_manifest(
        out, OutputManifest(command, __version__, complete=False, files=tuple(sorted({*old, *new})))
    )
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
    write_manifest(out, OutputManifest(command, __version__, complete=True, files=new))
