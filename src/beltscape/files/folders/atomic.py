"""Atomic writing: every file is written under a temporary name and then renamed."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from beltscape.core.errors import OutputError

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
