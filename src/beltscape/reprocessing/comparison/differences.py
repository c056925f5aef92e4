"""Where and how two ledgers differ: stretches beyond the difference's uncertainty, changed reasons, and the pattern.

A pattern is in proportion to the load, or the same cross-section all along the belt.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.core.arrays import Mask
from beltscape.core.ledger import STANDINGS
from beltscape.reprocessing.comparison.ledger import NO_TIME, Codes, Numbers
from beltscape.reprocessing.comparison.segments import Segments, Side
from beltscape.reprocessing.comparison.uncertainty import COVERAGE_FACTOR, PairedSums

NO_RECORD = "no record"
"""Stands for the standing of belt that a ledger does not have."""
_MOST_PAIRS = 5
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
    parts = [_describe_part(segments, kinds == kind) for kind in np.unique(kinds[codes[0] != codes[1]])]
    return tuple(sorted(parts, key=lambda part: -part.length_mm))


def encode_standings(side: Side) -> Codes:
    """Return the place of each segment's standing in `STANDINGS`; behind them: no record."""
    return np.where(side.record >= 0, side.columns.standing[side.record], len(STANDINGS))


def name_standing(code: int) -> str:
    """Return the word of a code of `encode_standings`."""
    return (*STANDINGS, NO_RECORD)[code]


def _describe_part(segments: Segments, chosen: Mask) -> BeltPart:
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
        reasons=tuple(pairs[:_MOST_PAIRS]),
        more_reasons=max(0, len(pairs) - _MOST_PAIRS),
    )


def find_connected(segments: Segments, chosen: Mask) -> list[tuple[int, int]]:
    """Return the connected stretches of chosen segments: first place, and the place behind the last."""
    touches = np.concatenate([[False], segments.edges_mm[1:, 0] == segments.edges_mm[:-1, 1]])
    starts = chosen & ~(touches & np.concatenate([[False], chosen[:-1]]))
    ends = chosen & ~np.concatenate([touches[1:] & chosen[1:], [False]])
    return list(zip(np.flatnonzero(starts).tolist(), (np.flatnonzero(ends) + 1).tolist(), strict=True))


def _list_reasons(segments: Segments, chosen: Mask) -> list[ReasonPair]:
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


def _encode_reasons(side: Side, chosen: Mask) -> tuple[list[str], Codes]:
    record = side.record[chosen]
    reasons = np.where(record >= 0, side.columns.reason[record], "")
    names, codes = np.unique(reasons, return_inverse=True)
    return [str(name) for name in names], codes


_MOST_STRETCHES = 10
"""Number of stretches that are listed."""
_MOST_REASONS = 3
"""Different reasons that are listed of a stretch. Chosen."""


@dataclass(frozen=True, slots=True)
class StretchSide:
    """One ledger's records on a stretch."""

    from_mm: float
    to_mm: float
    """Beginning of the first and end of the last record by this ledger's own count."""
    records: int
    first_frame: str
    last_frame: str
    standings: tuple[str, ...]
    """The standings on it, the best first."""
    reasons: tuple[str, ...]
    """The first different reasons."""
    volume_mm3: float
    sigma_mm3: float


@dataclass(frozen=True, slots=True)
class DifferingStretch:
    """A stretch of belt, within one interval, whose blocks all differ beyond their σ in the same direction."""

    from_mm: float
    to_mm: float
    """By the first ledger's count."""
    time_ns: int | None
    """Time of its first frame; None: not known."""
    difference_mm3: float
    sigma_mm3: float
    first: StretchSide
    second: StretchSide


def list_differing_stretches(
    segments: Segments, blocks: PairedSums, interval: Codes
) -> tuple[DifferingStretch, ...]:
    """Return the ten stretches whose difference exceeds twice its σ most; ``interval``: (m,) of each block."""
    sign = np.where(blocks.agrees | ~np.isfinite(blocks.difference_sigma), 0, np.sign(blocks.difference))
    sign = np.where(blocks.length_mm > 0, sign, 0).astype(np.int64)
    starts = np.concatenate([[True], (np.diff(sign) != 0) | (np.diff(interval) != 0)])
    group = np.where(sign != 0, np.cumsum(starts) - 1, -1)
    sums = blocks.group(group, int(starts.sum()))
    beyond = np.abs(sums.difference) - COVERAGE_FACTOR * sums.difference_sigma
    order = np.argsort(-beyond, kind="stable")
    chosen = [at for at in order.tolist() if beyond[at] > 0][:_MOST_STRETCHES]
    of_segment = np.where(segments.is_compared, group[segments.block], -1)
    return tuple(_describe_stretch(segments, of_segment == at, sums, at) for at in chosen)


def _describe_stretch(segments: Segments, chosen: Mask, sums: PairedSums, at: int) -> DifferingStretch:
    edges = segments.edges_mm[chosen]
    times = segments.time_ns[chosen]
    known = times[times != NO_TIME]
    return DifferingStretch(
        float(edges[0, 0]),
        float(edges[-1, 1]),
        int(known[0]) if len(known) else None,
        float(sums.difference[at]),
        float(sums.difference_sigma[at]),
        _describe_side(segments.first, chosen, float(sums.value[0, at]), float(sums.sigma[0, at])),
        _describe_side(segments.second, chosen, float(sums.value[1, at]), float(sums.sigma[1, at])),
    )


def _describe_side(side: Side, chosen: Mask, volume_mm3: float, sigma_mm3: float) -> StretchSide:
    columns, records = side.columns, np.unique(side.record[chosen])
    reasons = dict.fromkeys(str(text) for text in columns.reason[records] if text)
    return StretchSide(
        from_mm=float(columns.from_mm[records[0]]),
        to_mm=float(columns.to_mm[records[-1]]),
        records=len(records),
        first_frame=str(columns.frame[records[0]]),
        last_frame=str(columns.frame[records[-1]]),
        standings=tuple(name_standing(int(code)) for code in np.unique(encode_standings(side)[chosen])),
        reasons=tuple(reasons)[:_MOST_REASONS],
        volume_mm3=volume_mm3,
        sigma_mm3=sigma_mm3,
    )


_LEAST_INTERVALS = 8
"""Intervals that are needed to tell two patterns apart. Chosen."""
_EVIDENCE = 9.0
"""χ² by which a pattern must be better than none, and than the other one: 3 σ."""


@dataclass(frozen=True, slots=True)
class DifferencePattern:
    """A pattern that the differences of the intervals have in common."""

    kind: Literal["proportional", "constant"]
    value: float
    """Difference over the mean volume of both, or a cross-section in mm²."""
    sigma: float
    """One standard deviation of it, by the strips' own errors."""


def find_pattern(volume: PairedSums) -> DifferencePattern | None:
    """Return the pattern that explains the differences of the intervals; None if none does, or both do.

    Each pattern is fitted by weighted least squares. Errors that all strips share are left out of the weights: they
    change the fitted value and not whether the differences follow the pattern.
    """
    used = (volume.length_mm > 0) & (volume.own_apart > 0) & np.isfinite(volume.own_apart)
    if np.count_nonzero(used) < _LEAST_INTERVALS:
        return None
    difference, weight = volume.difference[used], 1 / volume.own_apart[used]
    none = float((weight * difference**2).sum())
    fits = [
        _fit_pattern("proportional", volume.value.mean(axis=0)[used], difference, weight),
        _fit_pattern("constant", volume.length_mm[used], difference, weight),
    ]
    (best, least), (_, second) = sorted(fits, key=lambda fit: fit[1])
    freedom = len(difference) - 1
    follows = least <= freedom + 3 * np.sqrt(2 * freedom)  # mean and three standard deviations of χ²
    return best if follows and none - least > _EVIDENCE and second - least > _EVIDENCE else None


def _fit_pattern(
    kind: Literal["proportional", "constant"], quantity: Numbers, difference: Numbers, weight: Numbers
) -> tuple[DifferencePattern, float]:
    """Return the pattern of differences in proportion to a quantity, and the χ² that it leaves."""
    norm = float((weight * quantity**2).sum())
    if norm <= 0:
        return DifferencePattern(kind, 0.0, np.inf), np.inf
    value = float((weight * quantity * difference).sum()) / norm
    return DifferencePattern(kind, value, norm**-0.5), float(
        (weight * (difference - value * quantity) ** 2).sum()
    )
