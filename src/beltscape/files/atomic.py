"""Writing of files, atomic or durable, and state that is set aside where it is damaged.

Results are written atomically: under a temporary name, then renamed, which is enough for what a command can make
again. What only this file knows, such as the last record that a broker has acknowledged, is written durably: its
content is on the disk before it gets its name.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from beltscape.core.errors import BeltscapeError, OutputError
from beltscape.core.system_calls import sync_folder

_LEAST_FREE = 1 << 20
"""Bytes (1 MiB). NumPy's failed writes have no error number; with less free space the disk is taken as full."""


@contextmanager
def atomic_replacement(path: Path) -> Generator[Path]:
    """Yield a temporary path beside ``path``; on success it becomes ``path``, on failure it is removed."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise output_error(path, error) from error
    finally:
        temporary.unlink(missing_ok=True) if temporary.parent.is_dir() else None


def make_folder_once(folder: Path, make: Callable[[Path], object]) -> None:
    """Make a folder where it is not there yet: as a whole or not at all, even if the program is killed."""
    if folder.is_dir():
        return
    part = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    make(part)
    part.rename(folder)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text, atomically; bytes of file names that are no UTF-8 become escapes, as JSON knows them."""
    with atomic_replacement(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes, atomically."""
    with atomic_replacement(path) as temporary:
        temporary.write_bytes(data)


def ensure_output_folder(path: Path) -> Path:
    """Make sure, before a long computation, that ``path`` is a writable folder; return it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / f".{os.getpid()}.probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise output_error(path, error) from error
    return path


def output_error(path: Path, error: OSError) -> OutputError:
    """Return the OutputError with the reason why ``path`` cannot be written, and the fix."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT) or (
        error.errno is None and _free_bytes(path) < _LEAST_FREE
    ):
        free = _free_bytes(path) / 2**20
        return OutputError(
            f"{path}: the disk is full ({free:.1f} MiB free there); free some space, or choose an --out elsewhere"
        )
    if error.errno == errno.EFBIG:
        return OutputError(
            f"{path}: larger than this file system allows; choose an --out on another file system"
        )
    if error.errno == errno.EROFS:
        return OutputError(f"{path}: the file system is read-only; choose an --out elsewhere")
    reason = error.strerror or str(error)
    if isinstance(error, FileExistsError | NotADirectoryError):
        reason = next((f"{p} is a file, not a folder" for p in (path, *path.parents) if p.is_file()), reason)
        links = (p for p in (path, *path.parents) if p.is_symlink() and not p.exists())
        reason = next((f"{p} is a broken link" for p in links), reason)
    return OutputError(f"{path}: cannot be written ({reason}); choose another output folder")


def _free_bytes(path: Path) -> int:
    """Return the free space on the file system of ``path``, or of its nearest existing parent."""
    existing = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    return shutil.disk_usage(existing).free


Content = TypeVar("Content")
DAMAGED = "damaged"
"""Folder beside the state for what was damaged, in a folder for each time."""
_STAMP = "%Y%m%dT%H%M%SZ"
"""Name of such a folder, UTC; they sort by age."""


def commit_file(temporary: Path, path: Path) -> None:
    """Rename a finished file to ``path``; content and name are on the disk when this returns. OSError otherwise."""
    with temporary.open("r+b") as file:
        os.fsync(file.fileno())
    temporary.replace(path)
    sync_folder(path.parent)


def write_durably(path: Path, data: bytes) -> None:
    """Replace a file durably and atomically; OSError if it cannot be written."""
    temporary = path.with_name(f".{path.name}.part")
    try:
        temporary.write_bytes(data)
        commit_file(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def keep_state(path: Path, data: bytes) -> None:
    """Replace a file of state durably and atomically; OutputError with cause and fix if it cannot be written."""
    try:
        write_durably(path, data)
    except OSError as error:
        raise OutputError(f"{path}: {describe_refusal(error)}") from error


def describe_refusal(error: OSError) -> str:
    """Return why the disk refused to be written, and the fix."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full; free some space"
    if error.errno == errno.EROFS:
        return "the file system is read-only; mount it writable"
    if error.errno in (errno.EACCES, errno.EPERM):
        return "it may not be written; correct the rights of file and folder"
    return f"cannot be written ({error.strerror or error}); check its disk"


def read_state(path: Path, parse: Callable[[bytes], Content], instead: str) -> tuple[Content | None, str]:
    """Return what a file of state holds, and in one line why it holds nothing; None and no line without the file.

    A file that ``parse`` cannot read, by whatever exception, or that cannot be opened, is set aside, so that a
    damaged one stops nobody. ``instead`` is the end of the line: what happens without the content.
    """
    try:
        return parse(path.read_bytes()), ""
    except FileNotFoundError:
        return None, ""
    except Exception as error:
        return None, f"{set_aside(path, describe_damage(path, error))}; {instead}"


def set_aside(path: Path, reason: str) -> str:
    """Move a damaged file to the folder of damaged ones; return the line that names it, ``reason`` and the place."""
    try:
        moved = move_aside(path)
    except OSError as error:
        return f"{path}: {reason} and cannot be moved away ({error.strerror or error})"
    return f"{path}: {reason} and was moved to {moved.parent}"


def move_aside(path: Path, beside: tuple[str, ...] = ()) -> Path:
    """Move a file, and those whose names continue its name by ``beside``, to a new folder; return its path there.

    Raises
    ------
    OSError
        If that is impossible.
    """
    names = (path.name, *(f"{path.name}{ending}" for ending in beside))
    stamp, again = time.strftime(_STAMP, time.gmtime()), 1
    place = path.parent / DAMAGED / stamp
    while any((place / name).exists() for name in names):
        again += 1
        place = path.parent / DAMAGED / f"{stamp}-{again}"
    place.mkdir(parents=True, exist_ok=True)
    for name in names:
        if (path.parent / name).exists():
            (path.parent / name).rename(place / name)
    return place / path.name


def describe_damage(path: Path, error: Exception) -> str:
    """Return in a few words why a file of state cannot be read."""
    if isinstance(error, OSError):
        return f"cannot be read ({error.strerror or error})"
    if isinstance(error, BeltscapeError):
        return str(error).removeprefix(f"{path}: ")
    with suppress(OSError):
        if path.stat().st_size == 0:
            return "is empty"
    if isinstance(error, json.JSONDecodeError | UnicodeDecodeError):
        return "is cut off or overwritten"
    return "does not hold what was written"
