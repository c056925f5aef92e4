"""The history of a rig's drift: one estimate every few hours, each against the first of the same rig."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class StoredDrift:
    """An estimate of a rig's drift."""

    number: int
    """Increases from estimate to estimate."""
    wall_ns: int
    """System clock at its last frame, ns since 1970."""
    rig: str
    """SHA-256 of the rig.json that it concerns."""
    document: Mapping[str, Any]
    """As `beltscape.pipeline.live.drift` wrote it."""


_SELECT = "SELECT estimate, wall_ns, rig, document FROM rig_drift"


def insert_drift(connection: sqlite3.Connection, wall_ns: int, rig: str, document: Mapping[str, Any]) -> None:
    """Store an estimate."""
    values = wall_ns, rig, json.dumps(dict(document))
    connection.execute("INSERT INTO rig_drift (wall_ns, rig, document) VALUES (?, ?, ?)", values)


def read_drifts(connection: sqlite3.Connection, rig: str, limit: int) -> list[StoredDrift]:
    """Return the newest estimates of a rig, oldest first."""
    rows = connection.execute(f"{_SELECT} WHERE rig = ? ORDER BY estimate DESC LIMIT ?", (rig, limit))
    return [_make(row) for row in rows][::-1]


def read_first_drift(connection: sqlite3.Connection, rig: str) -> StoredDrift | None:
    """Return the first estimate of a rig, the reference of all others; None before it."""
    rows = connection.execute(f"{_SELECT} WHERE rig = ? ORDER BY estimate LIMIT 1", (rig,))
    row = rows.fetchone()
    return None if row is None else _make(row)


def _make(row: tuple[Any, ...]) -> StoredDrift:
    return StoredDrift(row[0], row[1], row[2], json.loads(row[3]))
