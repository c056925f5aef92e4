"""The stretches of belt on which two ledgers differ most beyond the uncertainty of their difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.reprocessing.comparison.ledger import NO_TIME, Codes
from beltscape.reprocessing.comparison.reasons import encode_standings, name_standing
from beltscape.reprocessing.comparison.segments import Flags, Segments, Side
from beltscape.reprocessing.comparison.uncertainty import COVERAGE_FACTOR, PairedSums

_COUNT = 10
"""Number of stretches that are listed."""
_REASONS = 3
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
    chosen = [at for at in order.tolist() if beyond[at] > 0][:_COUNT]
    of_segment = np.where(segments.is_compared, group[segments.block], -1)
    return tuple(_describe(segments, of_segment == at, sums, at) for at in chosen)


def _describe(segments: Segments, chosen: Flags, sums: PairedSums, at: int) -> DifferingStretch:
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


def _describe_side(side: Side, chosen: Flags, volume_mm3: float, sigma_mm3: float) -> StretchSide:
    columns, records = side.columns, np.unique(side.record[chosen])
    reasons = dict.fromkeys(str(text) for text in columns.reason[records] if text)
    return StretchSide(
        from_mm=float(columns.from_mm[records[0]]),
        to_mm=float(columns.to_mm[records[-1]]),
        records=len(records),
        first_frame=str(columns.frame[records[0]]),
        last_frame=str(columns.frame[records[-1]]),
        standings=tuple(name_standing(int(code)) for code in np.unique(encode_standings(side)[chosen])),
        reasons=tuple(reasons)[:_REASONS],
        volume_mm3=volume_mm3,
        sigma_mm3=sigma_mm3,
    )
