"""A backup as one file, tar compressed by gzip or Zstandard, and its manifest.

The manifest says what the backup contains, with the SHA-256 of every file, and where each file belongs.
"""

from __future__ import annotations

import tarfile
import zlib
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import IO, Any, Literal

from beltscape.core.checks import is_dict
from beltscape.core.errors import InputError, describe_cause
from beltscape.files.json_text import add_digest, read_json, require_digest, write_json

MANIFEST_FILE = "manifest.json"
FORMAT = "beltscape-backup/1"
PROJECT, DATA, OUTSIDE = "project", "data", "outside"
"""Folders of a backup: files within the project's folder, the data folder, and files elsewhere."""
_FIX = "take another backup"


@dataclass(frozen=True, slots=True)
class BackupEntry:
    """One file of a backup."""

    size: int
    """Bytes."""
    sha256: str


@dataclass(frozen=True, slots=True)
class BackupManifest:
    """Contents of a backup."""

    made: str
    """UTC, ISO 8601."""
    program: str
    """Version of the program that made it."""
    schema: int
    """Version of the history's tables; a program with older tables cannot use it."""
    project: str
    """Name of project.toml."""
    data: str
    """The data folder as project.toml names it."""
    outside: Mapping[str, str]
    """Name in the backup → absolute path, of files outside the project's folder."""
    files: Mapping[str, BackupEntry]
    """Name in the backup, with slashes → the file."""


def write_manifest(folder: Path, manifest: BackupManifest) -> None:
    """Write the manifest into a backup's folder."""
    files = {name: {"bytes": one.size, "sha256": one.sha256} for name, one in manifest.files.items()}
    document = {
        "format": FORMAT,
        "made": manifest.made,
        "program": manifest.program,
        "schema": manifest.schema,
        "project": manifest.project,
        "data": manifest.data,
        "outside": dict(manifest.outside),
        "files": files,
    }
    write_json(folder / MANIFEST_FILE, add_digest(document))


def read_manifest(path: Path, named: Path) -> BackupManifest:
    """Return the manifest in the file ``path`` of the backup ``named``; InputError if it is damaged."""
    document = read_json(path)
    if not is_dict(document) or document.get("format") != FORMAT:
        raise InputError(f"{named}: its {MANIFEST_FILE} is not that of a backup; {_FIX}")
    require_digest(named / MANIFEST_FILE, document, _FIX)
    try:
        return _from_document(document)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{named}: its {MANIFEST_FILE} is damaged ({describe_cause(error)}); {_FIX}"
        ) from error


def _from_document(document: Mapping[str, Any]) -> BackupManifest:
    files = {
        _require_inner(name): BackupEntry(int(one["bytes"]), str(one["sha256"]))
        for name, one in document["files"].items()
    }
    return BackupManifest(
        str(document["made"]),
        str(document["program"]),
        int(document["schema"]),
        _require_inner(str(document["project"])),
        str(document["data"]),
        {str(name): str(place) for name, place in document["outside"].items()},
        files,
    )


def _require_inner(name: str) -> str:
    """Return a name within the backup; ValueError for one that leaves it."""
    parts = PurePosixPath(name).parts
    if not parts or PurePosixPath(name).is_absolute() or ".." in parts or "\\" in name or ":" in name:
        raise ValueError(f"{name!r} leaves the backup")
    return name


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
        archive.add(folder / MANIFEST_FILE, MANIFEST_FILE)
        for one in sorted(folder.rglob("*")):
            name = one.relative_to(folder).as_posix()
            if one.is_file() and name != MANIFEST_FILE:
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
            raise damage_error(path, MANIFEST_FILE, error) from error
        yield _list_members(path, archive)


def damage_error(path: Path, name: str, error: Exception) -> InputError:
    """Return the InputError about an archive that cannot be read on at a file."""
    return InputError(f"{path}: damaged or cut at {name} ({error}); take another backup")


def _list_members(path: Path, archive: tarfile.TarFile) -> Iterator[tuple[str, IO[bytes], int]]:
    place = MANIFEST_FILE
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
