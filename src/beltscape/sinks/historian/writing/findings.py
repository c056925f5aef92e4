"""Appending findings to the database, with their sums over ten minutes, in one transaction."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence

from beltscape.sinks.historian.storage.finding_rows import TEN_MINUTES_NS, StoredFinding, to_finding_row
from beltscape.sinks.historian.writing.ledger import transaction

_INSERT = (
    "INSERT INTO findings (series, wall_ns, value, sigma, bound, effect, text) VALUES (?, ?, ?, ?, ?, ?, ?)"
)
_ADD = """
    INSERT INTO finding_sums VALUES (:series, :bucket, :count, coalesce(:value, 0), :value, :value,
        coalesce(:sigma, 0), :sigma IS NOT NULL, :bound, :effect, :faults)
    ON CONFLICT (series, bucket) DO UPDATE SET
        count = count + excluded.count, total = total + excluded.total,
        low = min(coalesce(low, excluded.low), coalesce(excluded.low, low)),
        high = max(coalesce(high, excluded.high), coalesce(excluded.high, high)),
        sigma = sigma + excluded.sigma, sigmas = sigmas + excluded.sigmas,
        bound = max(coalesce(bound, excluded.bound), coalesce(excluded.bound, bound)),
        effect = max(effect, excluded.effect), faults = faults + excluded.faults"""


def append_findings(connection: sqlite3.Connection, findings: Sequence[StoredFinding]) -> None:
    """Store all or none of the findings. They are on disk when this returns; sqlite3.Error otherwise."""
    with transaction(connection):
        for stored in findings:
            series = _series(connection, stored)
            row = to_finding_row(stored)
            wall_ns, value, sigma, bound, effect, text = row
            connection.execute(_INSERT, (series, *row))
            connection.execute(
                _ADD,
                {
                    "series": series,
                    "bucket": wall_ns // TEN_MINUTES_NS,
                    "count": int(value is not None),
                    "value": value,
                    "sigma": sigma,
                    "bound": bound,
                    "effect": effect,
                    "faults": int(bool(text)),
                },
            )


def _series(connection: sqlite3.Connection, stored: StoredFinding) -> int:
    """Return the number of the finding's series, which is created where it is new."""
    key = (stored.finding.check, stored.finding.subject, stored.finding.unit)
    find = "SELECT series FROM checks WHERE name = ? AND subject = ? AND unit = ?"
    found = connection.execute(find, key).fetchone()
    if found is None:
        connection.execute("INSERT INTO checks (name, subject, unit) VALUES (?, ?, ?)", key)
        found = connection.execute(find, key).fetchone()
    return found[0]
