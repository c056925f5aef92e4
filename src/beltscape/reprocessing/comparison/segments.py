"""Alignment of two ledgers along the belt by the frames that both have, and segments between their records' edges.

Blocks of segments lie between edges that both ledgers have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Mask
from beltscape.core.errors import InputError
from beltscape.reprocessing.comparison.ledger import NO_TIME, Codes, ComparedLedger, LedgerColumns, Numbers

EDGE_MM = 1e-3
"""Edges of records within it are the same: a thousandth of a usual encoder's step, and far above the rounding of a
count of 10⁹ mm in double precision (1e-7 mm)."""
TIME_NS = 1000
"""Times of one frame are the same within it: a recording's times are read as seconds in double precision, which are
238 ns apart today."""
_JUMP = 0.1
"""Share of a strip's length by which the counts may drift within it; above it the strips are not the same. Chosen:
far above the drift by a calibration (per cent), far below the length that another frame adds."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The second ledger's records on the first ledger's belt."""

    from_mm: Numbers
    to_mm: Numbers
    """(n,) beginning and end of the second ledger's records by the first ledger's count, ascending."""
    shared_frames: int
    """Number of frames that both have, by name and time."""
    offset_mm: float
    """The first ledger's count minus the second's: the median over the shared frames."""
    spread_mm: float
    """Greatest minus least such difference; 0 where the offset is constant."""


def align_ledgers(first: ComparedLedger, second: ComparedLedger) -> Alignment:
    """Return the second ledger's records on the first ledger's belt.

    A constant difference of the counts is one offset. Where it varies (counts by the material's motion drift, an
    encoder restarted), each shared frame's record ends where the first ledger has it, and the records between shared
    frames are spread between them.

    Raises
    ------
    InputError
        If they have no frame in common, or have them in another order.
    """
    one, other = first.columns, second.columns
    at_one, at_other = _match_frames(one, other)
    pair = f"{first.folder} and {second.folder}"
    if not len(at_one):
        raise InputError(
            f"{pair}: have no frame of the same name and time; compare two measurements of the same recordings"
        )
    if (np.diff(at_other) <= 0).any():
        raise InputError(
            f"{pair}: have their frames in another order; their belt cannot be laid side by side"
        )
    shift = one.to_mm[at_one] - other.to_mm[at_other]
    offset, spread = float(np.median(shift)), float(np.ptp(shift))
    if spread <= EDGE_MM:
        from_mm, to_mm = other.from_mm + offset, other.to_mm + offset
    else:
        from_mm, to_mm = _follow_frames(one, other, at_one, at_other)
    edges = np.unique(np.concatenate([one.from_mm, one.to_mm]))
    return Alignment(_snap(from_mm, edges), _snap(to_mm, edges), len(at_one), offset, spread)


def _match_frames(one: LedgerColumns, other: LedgerColumns) -> tuple[Codes, Codes]:
    """Return the places of the frames that both have, in the first ledger's order.

    A name and time that a ledger has more than once identifies nothing and is left out.
    """
    places = [np.flatnonzero(columns.quality >= 0) for columns in (one, other)]
    frames = np.concatenate([one.frame[places[0]], other.frame[places[1]]])
    times = np.concatenate([one.time_ns[places[0]], other.time_ns[places[1]]])
    names = np.unique(frames, return_inverse=True)[1]
    order = np.lexsort((times, names))
    is_near = (np.diff(names[order]) == 0) & (np.diff(times[order]) <= TIME_NS)
    alone = np.concatenate([[True], ~is_near[:-1]]) & np.concatenate([~is_near[1:], [True]])
    is_second = order >= len(places[0])
    pair = np.flatnonzero(is_near & alone & (is_second[:-1] != is_second[1:])) if len(is_near) else order[:0]
    low, high = np.minimum(order[pair], order[pair + 1]), np.maximum(order[pair], order[pair + 1])
    at_one, at_other = places[0][low], places[1][high - len(places[0])]
    ascending = np.argsort(at_one)
    return at_one[ascending], at_other[ascending]


def _follow_frames(
    one: LedgerColumns, other: LedgerColumns, at_one: Codes, at_other: Codes
) -> tuple[Numbers, Numbers]:
    """Return the second ledger's edges where its shared frames end as in the first one."""
    ends = one.to_mm[at_one]
    length = other.length_mm[at_other]
    before = np.concatenate([[-np.inf], ends[:-1]])
    # a strip of about the same length is the same strip, although one count is a little longer
    is_same = np.abs(one.length_mm[at_one] - length) <= _JUMP * length + EDGE_MM
    starts = np.where(is_same, one.from_mm[at_one], np.maximum(ends - length, before))
    knots_other = np.stack([other.from_mm[at_other], other.to_mm[at_other]], axis=1).ravel()
    knots_one = np.stack([starts, ends], axis=1).ravel()
    from_mm, to_mm = _interpolate(other, knots_other, knots_one)
    from_mm[at_other], to_mm[at_other] = starts, ends
    return from_mm, to_mm


def _interpolate(other: LedgerColumns, knots_other: Numbers, knots_one: Numbers) -> tuple[Numbers, Numbers]:
    """Return edges between knots in proportion, and outside them with the offset of the nearest one."""

    def move(edges: Numbers) -> Numbers:
        outside = np.minimum(edges - knots_other[0], 0) + np.maximum(edges - knots_other[-1], 0)
        return np.interp(edges, knots_other, knots_one) + outside

    return move(other.from_mm), move(other.to_mm)


def _snap(edges: Numbers, to: Numbers) -> Numbers:
    """Return edges moved to the nearest of the sorted values ``to`` where one is within `EDGE_MM`."""
    right = np.clip(np.searchsorted(to, edges), 0, len(to) - 1)
    left = np.maximum(right - 1, 0)
    nearest: NDArray[np.float64] = np.where(
        np.abs(to[left] - edges) <= np.abs(to[right] - edges), to[left], to[right]
    )
    return np.where(np.abs(nearest - edges) <= EDGE_MM, nearest, edges)


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One ledger's part in n segments."""

    ledger: ComparedLedger
    record: Codes
    """(n,) place of the record that covers a segment; -1: the ledger has no record there."""
    share: Numbers
    """(n,) share of that record's length."""
    is_counted: Mask
    """(n,) whether the ledger has a volume there."""

    @property
    def columns(self) -> LedgerColumns:
        """Return the ledger's columns."""
        return self.ledger.columns

    def take(self, values: Numbers) -> Numbers:
        """Return a record's quantity per segment; NaN where the ledger has no record."""
        return np.where(self.record >= 0, values[self.record], np.nan)

    def split(self, values: Numbers) -> Numbers:
        """Return a record's sum divided among its segments by length; 0 where nothing is counted."""
        return np.where(self.is_counted, values[self.record] * self.share, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """n segments of belt in order, none without length."""

    edges_mm: Numbers
    """(n, 2) beginning and end by the first ledger's count."""
    first: Side
    second: Side
    block: Codes
    """(n,) number of the block from 0, ascending; records of both ledgers begin and end together at its ends."""

    @property
    def length_mm(self) -> Numbers:
        """Return the length of each segment."""
        return self.edges_mm[:, 1] - self.edges_mm[:, 0]

    @property
    def is_compared(self) -> Mask:
        """Return where both ledgers have a volume."""
        return self.first.is_counted & self.second.is_counted

    @property
    def seconds(self) -> Numbers:
        """Return how long the belt took by the records' speed, the mean of both ledgers; NaN: not known."""
        each = [
            _divide(side.split(side.columns.length_mm), side.take(side.columns.speed_mm_s))
            for side in (self.first, self.second)
        ]
        known = [np.isfinite(seconds) for seconds in each]
        total = sum(np.where(good, seconds, 0.0) for good, seconds in zip(known, each, strict=True))
        return _divide(np.asarray(total, np.float64), known[0].astype(np.float64) + known[1])

    @property
    def time_ns(self) -> Codes:
        """Return the trigger time of the records' frames, the earlier one of both; `NO_TIME`: not known."""
        times = [
            np.where(side.record >= 0, side.columns.time_ns[side.record], NO_TIME)
            for side in (self.first, self.second)
        ]
        low, high = np.minimum(*times), np.maximum(*times)
        return np.where(low == NO_TIME, high, low)


def make_segments(first: ComparedLedger, second: ComparedLedger, alignment: Alignment) -> Segments:
    """Return the segments of all belt that either ledger has."""
    one = first.columns
    edges_one = np.unique(np.concatenate([one.from_mm, one.to_mm]))
    edges_other = np.unique(np.concatenate([alignment.from_mm, alignment.to_mm]))
    edges = np.union1d(edges_one, edges_other)
    pairs = np.stack([edges[:-1], edges[1:]], axis=1)
    sides = (
        _make_side(first, one.from_mm, one.to_mm, pairs),
        _make_side(second, alignment.from_mm, alignment.to_mm, pairs),
    )
    is_common = np.isin(pairs[:, 0], edges_one) & np.isin(pairs[:, 0], edges_other)
    block: Codes = np.cumsum(is_common, dtype=np.int64)
    return _select(pairs, sides, block, (sides[0].record >= 0) | (sides[1].record >= 0))


def _make_side(ledger: ComparedLedger, from_mm: Numbers, to_mm: Numbers, pairs: Numbers) -> Side:
    """Return the records of a ledger, with their edges on the common belt, in the segments ``pairs``."""
    columns = ledger.columns
    with_length = np.flatnonzero(to_mm > from_mm)
    at = np.searchsorted(from_mm[with_length], pairs[:, 0], side="right") - 1
    record = (
        np.where(at >= 0, with_length[np.maximum(at, 0)], -1) if len(with_length) else np.full(len(at), -1)
    )
    record = np.where((record >= 0) & (to_mm[record] >= pairs[:, 1]), record, -1)
    length = to_mm[record] - from_mm[record]
    share = np.where(record >= 0, _divide(pairs[:, 1] - pairs[:, 0], length), 0.0)
    return Side(ledger, record, share, (record >= 0) & columns.is_counted[record])


def _select(pairs: Numbers, sides: tuple[Side, Side], block: Codes, kept: Mask) -> Segments:
    chosen = [Side(side.ledger, side.record[kept], side.share[kept], side.is_counted[kept]) for side in sides]
    return Segments(pairs[kept], chosen[0], chosen[1], np.unique(block[kept], return_inverse=True)[1])


def _divide(top: Numbers, bottom: Numbers) -> Numbers:
    """Return the quotient; NaN where the divisor is not positive."""
    return np.divide(top, bottom, out=np.full(len(top), np.nan), where=bottom > 0)
