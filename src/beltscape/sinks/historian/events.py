"""Events in the historian, which are alarms, notes and operator actions, and the runs of the history.

A run says which rig, empty belt and settings each record was measured by.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Event:
    """One event."""

    number: int
    """Increases from event to event."""
    wall_ns: int
    """System clock, ns since 1970."""
    kind: str
    """Such as "alarm", "note", "audit"."""
    name: str
    """Name of the alarm or the subject."""
    text: str
    """Description in one line."""
    by: str
    """User who caused it; empty without one."""
    parameters: str = ""
    """The parts of the text as a JSON object, from which a page composes it in another language; empty: none."""


@dataclass(frozen=True, slots=True)
class NewEvent:
    """An event that is to be stored; see `Event`."""

    kind: str
    name: str
    text: str
    wall_ns: int
    by: str = ""
    parameters: Mapping[str, object] | None = None
    """The parts of the text, from which a page composes it in another language."""


def insert_events(connection: sqlite3.Connection, events: Sequence[NewEvent]) -> None:
    """Store events in their order, all or none, within a transaction."""
    connection.executemany(
        "INSERT INTO events (wall_ns, kind, name, text, by, parameters) VALUES (?, ?, ?, ?, ?, ?)",
        (
            (one.wall_ns, one.kind, one.name, one.text, one.by, _format_parameters(one.parameters))
            for one in events
        ),
    )


def _format_parameters(parameters: Mapping[str, object] | None) -> str:
    return json.dumps(parameters) if parameters else ""


def read_journal(
    connection: sqlite3.Connection,
    period_ns: tuple[int, int],
    after: int,
    limit: int,
    name: str = "",
    *,
    newest: bool = False,
) -> tuple[Event, ...]:
    """Return events about alarms with numbers above ``after``: the oldest ones first, or the newest ones first.

    ``name``: of this alarm alone.
    """
    rows = connection.execute(
        "SELECT event, wall_ns, kind, name, text, by, parameters FROM events "
        "WHERE event > ? AND wall_ns >= ? AND wall_ns < ? AND kind = 'alarm' AND (? = '' OR name = ?) "
        f"ORDER BY event {'DESC' if newest else 'ASC'} LIMIT ?",
        (after, *period_ns, name, name, limit),
    )
    return tuple(Event(*row) for row in rows)


def read_events(
    connection: sqlite3.Connection, since_ns: int, until_ns: int, limit: int
) -> tuple[Event, ...]:
    """Return the events of a period, newest first."""
    rows = connection.execute(
        "SELECT event, wall_ns, kind, name, text, by, parameters FROM events WHERE wall_ns >= ? AND wall_ns < ? "
        "ORDER BY event DESC LIMIT ?",
        (since_ns, until_ns, limit),
    )
    return tuple(Event(*row) for row in rows)


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
