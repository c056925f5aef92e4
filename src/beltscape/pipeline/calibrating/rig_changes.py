"""Changes of a plant's rig by a proposal: taken by a person, kept with what was before, and undone as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from beltscape.core.errors import InputError, OutputError
from beltscape.files.atomic import ensure_output_folder, write_bytes
from beltscape.files.json_text import hash_file, read_json, write_json
from beltscape.files.rig_json import write_rig
from beltscape.pipeline.calibrating.drift import RigDrift

FOLDER = "rigs"
"""Folder beside the history of all rigs that were replaced, by their SHA-256, and of `JOURNAL`."""
JOURNAL = "changes.json"


@dataclass(frozen=True, slots=True)
class RigChange:
    """A change of the rig's file."""

    action: str
    """"taken" or "undone"."""
    before: str
    """SHA-256 of the file before."""
    after: str
    estimate: int
    """Number of the estimate that was taken."""
    by: str

    @property
    def detail(self) -> dict[str, str | int]:
        """Return what an audit log keeps of it."""
        return {"estimate": self.estimate, "rig_before": self.before, "rig_after": self.after}


def read_changes(data: Path) -> list[Mapping[str, Any]]:
    """Return all changes, oldest first."""
    path = data / FOLDER / JOURNAL
    return list(read_json(path)["changes"]) if path.is_file() else []


def take_proposal(
    data: Path, found: RigDrift, number: int, by: str, now: datetime | None = None
) -> RigChange:
    """Replace the rig's file by the proposal of the newest estimate, and keep the one before.

    Raises
    ------
    InputError
        If the estimate is not the newest one, or nothing has moved.
    OutputError
        If a file cannot be written; then nothing has changed.
    """
    newest = found.newest
    if newest is None or newest.number != number:
        is_newest = "there is none yet" if newest is None else f"the newest is {newest.number}"
        raise InputError(f"estimate {number}: {is_newest}; read the drift again and take that one")
    if found.proposed is None:
        raise InputError(f"estimate {number}: nothing has moved; there is nothing to take")
    _require_unchanged(found.rig_path, found.digest)
    kept = ensure_output_folder(data / FOLDER)
    write_bytes(kept / f"{found.digest}.json", found.rig_path.read_bytes())
    quality = {**found.proposed.quality, "drift": {"estimate": number, "from_rig": found.digest}}
    write_rig(found.rig_path, replace(found.proposed, quality=quality))
    change = RigChange("taken", found.digest, hash_file(found.rig_path), number, by)
    _keep_change(data, found.rig_path, change, now)
    return change


def undo_change(data: Path, rig_path: Path, by: str, now: datetime | None = None) -> RigChange:
    """Put back the rig that the last taken proposal replaced, byte by byte; the taken one is kept, too.

    Raises
    ------
    InputError
        If none was taken, or the rig's file has changed since.
    """
    changes = read_changes(data)
    if not changes or changes[-1]["action"] != "taken":
        raise InputError(
            f"{data / FOLDER}: no proposal was taken since the last undo; there is nothing to undo"
        )
    last = changes[-1]
    _require_unchanged(rig_path, last["after"])
    kept = data / FOLDER / f"{last['before']}.json"
    if not kept.is_file() or hash_file(kept) != last["before"]:
        raise InputError(f"{kept}: is missing or damaged; restore it from a backup, or calibrate again")
    write_bytes(data / FOLDER / f"{last['after']}.json", rig_path.read_bytes())
    write_bytes(rig_path, kept.read_bytes())
    change = RigChange("undone", last["after"], last["before"], int(last["estimate"]), by)
    _keep_change(data, rig_path, change, now)
    return change


def withdraw_change(data: Path, rig_path: Path, change: RigChange) -> None:
    """Put the rig's file and the journal back as they were before the last change, which a running plant refused.

    Raises
    ------
    InputError
        If the rig's file, or the kept one, has changed since.
    """
    _require_unchanged(rig_path, change.after)
    kept = data / FOLDER / f"{change.before}.json"
    _require_unchanged(kept, change.before)
    write_bytes(rig_path, kept.read_bytes())
    write_json(data / FOLDER / JOURNAL, {"changes": read_changes(data)[:-1]})


def _require_unchanged(path: Path, digest: str) -> None:
    if hash_file(path) != digest:
        raise InputError(f"{path}: has changed meanwhile; read the drift again")


def _keep_change(data: Path, rig_path: Path, change: RigChange, now: datetime | None) -> None:
    """Add a change to the journal; put the rig's file back where that cannot be written."""
    at = (now or datetime.now(UTC)).isoformat(timespec="seconds")
    entry = {"at": at, "by": change.by, "action": change.action, **{
        "before": change.before, "after": change.after, "estimate": change.estimate,
    }}  # fmt: skip
    try:
        write_json(data / FOLDER / JOURNAL, {"changes": [*read_changes(data), entry]})
    except OutputError:
        write_bytes(rig_path, (data / FOLDER / f"{change.before}.json").read_bytes())
        raise
