"""The manifest of a backup: what it contains, with the SHA-256 of every file, and where each file belongs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from beltscape.core.errors import InputError, describe_cause
from beltscape.core.type_guards import is_dict
from beltscape.files.documents.digest import add_digest, require_digest
from beltscape.files.documents.json_text import read_json, write_json

FILE = "manifest.json"
FORMAT = "beltscape-backup/1"
PROJECT, DATA, OUTSIDE = "project", "data", "outside"
"""Folders of a backup: files within the project's folder, the data folder, and files elsewhere."""
_FIX = "take another backup"


@dataclass(frozen=True, slots=True)
class Entry:
    """One file of a backup."""

    size: int
    """Bytes."""
    sha256: str


@dataclass(frozen=True, slots=True)
class Manifest:
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
    files: Mapping[str, Entry]
    """Name in the backup, with slashes → the file."""


def write_manifest(folder: Path, manifest: Manifest) -> None:
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
    write_json(folder / FILE, add_digest(document))


def read_manifest(path: Path, named: Path) -> Manifest:
    """Return the manifest in the file ``path`` of the backup ``named``; InputError if it is damaged."""
    document = read_json(path)
    if not is_dict(document) or document.get("format") != FORMAT:
        raise InputError(f"{named}: its {FILE} is not that of a backup; {_FIX}")
    require_digest(named / FILE, document, _FIX)
    try:
        return _from_document(document)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{named}: its {FILE} is damaged ({describe_cause(error)}); {_FIX}") from error


def _from_document(document: Mapping[str, Any]) -> Manifest:
    files = {
        _require_inner(name): Entry(int(one["bytes"]), str(one["sha256"]))
        for name, one in document["files"].items()
    }
    return Manifest(
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
