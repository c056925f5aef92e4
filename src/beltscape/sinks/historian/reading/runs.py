"""The runs of the history: which rig, empty belt and settings each record was measured by."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Run:
    """The program's work with one rig, one empty belt and one set of measuring settings."""

    number: int
    """The ``run`` of its records."""
    wall_ns: int
    """System clock at its begin, ns since 1970."""
    provenance: Mapping[str, str]
    """Version of the program, SHA-256 of rig, empty belt and settings; empty: begun by a version before 0.2."""


def read_runs(connection: sqlite3.Connection, limit: int) -> list[Run]:
    """Return the newest runs, the newest first."""
    rows = connection.execute("SELECT run, wall_ns, provenance FROM runs ORDER BY run DESC LIMIT ?", (limit,))
    return [Run(number, wall_ns, json.loads(text)) for number, wall_ns, text in rows]
