"""Catching up with a belt's records: each counts once by its number, also after hours without the connection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from beltscape.site.client import BeltFault, RecordAnswer
from beltscape.site.settings import QUARTER_MIN

_GAP_MS = 5000
"""A stretch that was not measured and passed within a shorter time is a share of its second, no gap. Chosen: a
window of a balance has minutes."""
QUARTER_S = QUARTER_MIN * 60
"""Seconds of a quarter of an hour."""
GapReason = Literal["not_running", "missing", "clock", "replaced", "pruned"]
"""Why what passed in a period is not known: the program did not run, nothing was measured, the clock was wrong, the
ledger was replaced, or the ledger no longer holds the records."""


@dataclass(frozen=True, slots=True)
class RecordSums:
    """Sums of records."""

    records: int = 0
    volume_m3: float = 0.0
    sigma_m3: float = 0.0
    """One standard deviation; the sum of the records' own, since their errors are correlated: an upper bound."""
    mass_t: float = 0.0
    """Mass of the records with a known density."""
    unweighed_m3: float = 0.0
    """Volume of the records without one."""
    valid_m: float = 0.0
    degraded_m: float = 0.0
    missing_m: float = 0.0

    def __add__(self, other: RecordSums) -> RecordSums:
        """Return the sums of both."""
        return RecordSums(*(getattr(self, name) + getattr(other, name) for name in FIELDS))

    @property
    def length_m(self) -> float:
        """Return the length of belt that passed."""
        return self.valid_m + self.degraded_m + self.missing_m


FIELDS = tuple(RecordSums.__dataclass_fields__)
"""Names of the sums."""


def sum_record(record: RecordAnswer) -> RecordSums:
    """Return the sums of one record."""
    volume = record.volume_m3 or 0.0
    lengths = {f"{record.standing}_m": record.length_m}
    return RecordSums(
        records=1,
        volume_m3=volume,
        sigma_m3=record.sigma_m3 or 0.0,
        mass_t=record.mass_t or 0.0,
        unweighed_m3=volume if record.mass_t is None else 0.0,
        **lengths,
    )


@dataclass(frozen=True, slots=True)
class Gap:
    """A period of which it is not known what passed on a belt; ms since 1970 by the belt's clock."""

    from_ms: int
    to_ms: int
    reason: GapReason


@dataclass(frozen=True, slots=True)
class Cursor:
    """The last record that was counted."""

    number: int
    run: int
    wall_ms: int
    mark: str
    """What tells this record from another one of the same number."""

    @classmethod
    def from_record(cls, record: RecordAnswer) -> Cursor:
        """Return the cursor at a record."""
        return cls(record.number, record.run, record.wall_ms, record.mark)


@dataclass(frozen=True, slots=True)
class PieceSums:
    """Sums that a piece of the ledger adds."""

    cursor: Cursor
    """The last record of it."""
    seconds: dict[int, RecordSums]
    """Second since 1970 → sums."""
    quarters: dict[int, RecordSums]
    """Second at which a quarter of an hour begins → sums."""
    gaps: tuple[Gap, ...]


def find_break(cursor: Cursor, records: Sequence[RecordAnswer]) -> BeltFault | None:
    """Return why a ledger does not go on behind the cursor; None: it does.

    ``records`` begin with the record of the cursor's number, where the ledger still holds it.
    """
    first = records[0] if records else None
    if first is not None and first.mark == cursor.mark:
        return None
    if first is not None and first.number > cursor.number:
        return BeltFault("pruned", {"first": cursor.number + 1, "last": first.number - 1})
    return BeltFault("replaced", {"number": cursor.number})


def sum_records(
    cursor: Cursor | None, records: Sequence[RecordAnswer], broken: BeltFault | None
) -> PieceSums | None:
    """Return what new records add behind the cursor; None if there are none.

    ``broken``: why the ledger does not go on behind the cursor, as `find_break` returns it.
    """
    seconds: dict[int, RecordSums] = {}
    quarters: dict[int, RecordSums] = {}
    gaps: list[Gap] = []
    if cursor is not None and broken is not None and records:
        reason: GapReason = "pruned" if broken.key == "pruned" else "replaced"
        gaps.append(Gap(cursor.wall_ms, records[0].wall_ms, reason))
        cursor = replace(cursor, run=records[0].run)
    for record in records:
        if cursor is not None:
            gaps.extend(_find_gaps(cursor, record))
        sums, second = sum_record(record), record.wall_ms // 1000
        quarter = second - second % QUARTER_S
        seconds[second] = seconds.get(second, RecordSums()) + sums
        quarters[quarter] = quarters.get(quarter, RecordSums()) + sums
        cursor = Cursor.from_record(record)
    return PieceSums(cursor, seconds, quarters, tuple(gaps)) if cursor is not None and records else None


def _find_gaps(before: Cursor, record: RecordAnswer) -> list[Gap]:
    """Return the gap between two records, if there is one."""
    if record.run != before.run:
        return [Gap(min(before.wall_ms, record.wall_ms), max(before.wall_ms, record.wall_ms), "not_running")]
    if record.standing == "missing" and record.length_m > 0 and record.wall_ms - before.wall_ms > _GAP_MS:
        return [Gap(before.wall_ms, record.wall_ms, "missing")]
    return []
