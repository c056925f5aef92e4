"""Backups as one file: tar, compressed by gzip or Zstandard."""

from __future__ import annotations

import tarfile
import zlib
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import IO, Any, Literal

from beltscape.core.errors import InputError
from beltscape.service.backup.manifest import FILE

Form = Literal["folder", "tar.gz", "tar.zst"]
FORMS: tuple[Form, ...] = ("folder", "tar.gz", "tar.zst")
DAMAGE = (tarfile.TarError, zlib.error, OSError, EOFError, ValueError)
"""The errors of reading a damaged archive."""
_GZIP_LEVEL = 6
"""gzip's own default; the standard library's 9 takes three times as long for a hundredth less."""


def find_form(path: Path) -> Form:
    """Return the form of a backup by its name; InputError if it is none."""
    if path.is_dir():
        return "folder"
    if not path.exists():
        raise InputError(f"{path}: there is no such backup")
    for form in FORMS[1:]:
        if path.name.endswith(f".{form}"):
            return form
    raise InputError(f"{path}: is no backup; give a folder, a .tar.gz or a .tar.zst of beltscape backup")


def write_archive(folder: Path, path: Path, form: Form) -> None:
    """Write a backup's folder to one file, the manifest first."""
    with _open_stream(path, form, "wb") as stream, tarfile.open(fileobj=stream, mode="w|") as archive:
        archive.add(folder / FILE, FILE)
        for one in sorted(folder.rglob("*")):
            name = one.relative_to(folder).as_posix()
            if one.is_file() and name != FILE:
                archive.add(one, name)


@contextmanager
def read_archive(path: Path, form: Form) -> Generator[Iterator[tuple[str, IO[bytes], int]]]:
    """Yield the files of an archive in order: name, content and mode.

    Raises
    ------
    InputError
        If the archive is cut or damaged; the name of the last file that could be begun is in the line.
    """
    with _open_stream(path, form, "rb") as stream:
        try:
            archive = tarfile.open(fileobj=stream, mode="r|")  # noqa: SIM115  (the stream is closed)
        except DAMAGE as error:
            raise damage_error(path, FILE, error) from error
        yield _list_members(path, archive)


def damage_error(path: Path, name: str, error: Exception) -> InputError:
    """Return the InputError about an archive that cannot be read on at a file."""
    return InputError(f"{path}: damaged or cut at {name} ({error}); take another backup")


def _list_members(path: Path, archive: tarfile.TarFile) -> Iterator[tuple[str, IO[bytes], int]]:
    place = FILE
    while True:
        try:
            member = archive.next()
        except DAMAGE as error:
            raise damage_error(path, f"the file after {place}", error) from error
        if member is None:
            return
        place = member.name
        if member.isdir():
            continue
        content = archive.extractfile(member) if member.isreg() else None
        if content is None:
            raise InputError(f"{path}: {member.name} is no file; take another backup")
        yield member.name, content, member.mode


@contextmanager
def _open_stream(path: Path, form: Form, mode: Literal["rb", "wb"]) -> Generator[Any]:
    if form == "tar.gz":
        import gzip

        with gzip.open(path, mode, compresslevel=_GZIP_LEVEL) as stream:
            yield stream
    else:
        pyarrow: Any = import_module("pyarrow")
        open_stream = pyarrow.output_stream if mode == "wb" else pyarrow.input_stream
        with open_stream(str(path), compression="zstd") as stream:
            yield stream
