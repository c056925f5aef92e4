"""Conversion between findings and rows of the database's tables; NaN is NULL."""

from __future__ import annotations

import math
from dataclasses import dataclass

from beltscape.core.live.findings import EFFECTS, Finding

TEN_MINUTES_NS = 600_000_000_000
"""Width of the intervals of the sums."""
MAX_TEXT = 500
"""Longer texts are cut; the messages of the checks have up to 300 characters."""


@dataclass(frozen=True, slots=True)
class StoredFinding:
    """A finding and its time."""

    wall_ns: int
    """System clock, ns since 1970."""
    finding: Finding


def to_finding_row(stored: StoredFinding) -> tuple[int, float | None, float | None, float | None, int, str]:
    """Return time, value, σ, limit, effect and text as the table ``findings`` has them."""
    finding = stored.finding
    return (
        int(stored.wall_ns),
        to_null(finding.value),
        to_null(finding.sigma),
        to_null(finding.limit),
        EFFECTS.index(finding.effect),
        finding.text[:MAX_TEXT],
    )


def to_null(value: float) -> float | None:
    """Return the value; None where it is not finite."""
    return float(value) if math.isfinite(value) else None
