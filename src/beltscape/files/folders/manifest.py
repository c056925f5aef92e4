"""The manifest of an output folder: the command that wrote it, its files, and whether it has finished."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from beltscape.core.errors import InputError, OutputError
from beltscape.files.folders.atomic import write_text

MANIFEST = ".beltscape.json"
"""Name of the manifest in an output folder."""
STAGING = ".beltscape-partial"
"""Folder in an output folder in which a command writes until it has finished."""
_FORMAT = "beltscape-output/1"


@dataclass(frozen=True, slots=True)
class Manifest:
    """Description of a command's output in its folder."""

    command: str
    """Name of the command as on the command line, such as ``measure volume``."""
    version: str
    """Version of Beltscape."""
    complete: bool
    """False while files are being replaced: an interrupted command leaves it so."""
    files: tuple[str, ...]
    """Relative to the folder, with slashes, sorted."""


def read_manifest(folder: Path) -> Manifest | None:
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


def parse_manifest(data: bytes) -> Manifest:
    """Return the manifest in the bytes of its file; ValueError where it is damaged."""
    try:
        document = json.loads(data)
        if document["format"] != _FORMAT or not all(isinstance(name, str) for name in document["files"]):
            raise ValueError(document["format"])
        return Manifest(
            str(document["command"]),
            str(document["version"]),
            bool(document["complete"]),
            tuple(document["files"]),
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"no manifest: {error!r}") from error


def write_manifest(folder: Path, manifest: Manifest) -> None:
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


def describe_unfinished(manifest: Manifest | None, *, is_staged: bool) -> str:
    """Return why a folder is not finished, with the fix; empty if it is. ``is_staged``: it holds `STAGING`."""
    if manifest is None and is_staged:
        return (
            "the command that writes it was interrupted or still runs; "
            "wait for it, or run it again with the same --out"
        )
    if manifest is not None and not manifest.complete:
        return f"beltscape {manifest.command} was interrupted while it wrote this folder; run it again"
    return ""
