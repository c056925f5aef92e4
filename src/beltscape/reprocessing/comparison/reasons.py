"""Reasons of records on both sides of a comparison, with the length of belt that they hold for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.core.belt.ledger_entries import STANDINGS
from beltscape.reprocessing.comparison.ledger import Codes
from beltscape.reprocessing.comparison.segments import Flags, Segments, Side

NO_RECORD = "no record"
"""Stands for the standing of belt that a ledger does not have."""
_MOST = 5
"""Pairs of reasons that are listed; the rest is counted. Chosen."""


@dataclass(frozen=True, slots=True)
class ReasonPair:
    """The reasons of both ledgers for the same belt."""

    first: str
    second: str
    length_mm: float


@dataclass(frozen=True, slots=True)
class BeltPart:
    """Belt that both ledgers count in another way, or that only one of them has."""

    first: str
    """Standing in the first ledger, or `NO_RECORD`."""
    second: str
    """Standing in the second ledger, or `NO_RECORD`."""
    length_mm: float
    stretches: int
    """Number of connected stretches."""
    volume_mm3: float
    """Volume that one ledger counts on it and the other does not; 0 where both count it."""
    longest_mm: tuple[float, float]
    """Beginning and end of the longest stretch, by the first ledger's count."""
    reasons: tuple[ReasonPair, ...]
    """The reasons with the greatest lengths first."""
    more_reasons: int
    """Number of pairs that are not listed."""


def list_changed_standings(segments: Segments) -> tuple[BeltPart, ...]:
    """Return the belt of which only the standing differs or that only one ledger has, the longest part first."""
    sides = segments.first, segments.second
    codes = [encode_standings(side) for side in sides]
    kinds = codes[0] * (len(STANDINGS) + 1) + codes[1]
    parts = [_describe(segments, kinds == kind) for kind in np.unique(kinds[codes[0] != codes[1]])]
    return tuple(sorted(parts, key=lambda part: -part.length_mm))


def encode_standings(side: Side) -> Codes:
    """Return the place of each segment's standing in `STANDINGS`; behind them: no record."""
    return np.where(side.record >= 0, side.columns.standing[side.record], len(STANDINGS))


def name_standing(code: int) -> str:
    """Return the word of a code of `encode_standings`."""
    return (*STANDINGS, NO_RECORD)[code]


def _describe(segments: Segments, chosen: Flags) -> BeltPart:
    sides = segments.first, segments.second
    standings = [name_standing(int(encode_standings(side)[chosen][0])) for side in sides]
    pairs = _list_reasons(segments, chosen)
    alone = np.zeros(len(chosen))
    for side in sides:
        alone += np.where(chosen & ~segments.is_compared, side.split(side.columns.volume_mm3), 0.0)
    runs = find_connected(segments, chosen)
    lengths = [segments.edges_mm[end - 1, 1] - segments.edges_mm[start, 0] for start, end in runs]
    start, end = runs[int(np.argmax(lengths))]
    return BeltPart(
        *standings,
        length_mm=float(segments.length_mm[chosen].sum()),
        stretches=len(runs),
        volume_mm3=float(alone.sum()),
        longest_mm=(float(segments.edges_mm[start, 0]), float(segments.edges_mm[end - 1, 1])),
        reasons=tuple(pairs[:_MOST]),
        more_reasons=max(0, len(pairs) - _MOST),
    )


def find_connected(segments: Segments, chosen: Flags) -> list[tuple[int, int]]:
    """Return the connected stretches of chosen segments: first place, and the place behind the last."""
    touches = np.concatenate([[False], segments.edges_mm[1:, 0] == segments.edges_mm[:-1, 1]])
    starts = chosen & ~(touches & np.concatenate([[False], chosen[:-1]]))
    ends = chosen & ~np.concatenate([touches[1:] & chosen[1:], [False]])
    return list(zip(np.flatnonzero(starts).tolist(), (np.flatnonzero(ends) + 1).tolist(), strict=True))


def _list_reasons(segments: Segments, chosen: Flags) -> list[ReasonPair]:
    """Return the pairs of reasons on chosen segments, the longest first; none where both are empty."""
    names, codes = zip(
        *(_encode_reasons(side, chosen) for side in (segments.first, segments.second)), strict=True
    )
    kinds, place = np.unique(codes[0] * len(names[1]) + codes[1], return_inverse=True)
    lengths = np.bincount(place, segments.length_mm[chosen], len(kinds))
    pairs = [
        ReasonPair(names[0][kind // len(names[1])], names[1][kind % len(names[1])], float(length))
        for kind, length in zip(kinds.tolist(), lengths, strict=True)
    ]
    return sorted(
        (p for p in pairs if p.first or p.second), key=lambda pair: (-pair.length_mm, pair.first, pair.second)
    )


def _encode_reasons(side: Side, chosen: Flags) -> tuple[list[str], Codes]:
    record = side.record[chosen]
    reasons = np.where(record >= 0, side.columns.reason[record], "")
    names, codes = np.unique(reasons, return_inverse=True)
    return [str(name) for name in names], codes
