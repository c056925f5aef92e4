"""Segments of belt between the edges of both ledgers' records, and blocks of them between edges that both have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.reprocessing.comparison.alignment import Alignment
from beltscape.reprocessing.comparison.ledger import NO_TIME, Codes, ComparedLedger, LedgerColumns, Numbers

Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One ledger's part in n segments."""

    ledger: ComparedLedger
    record: Codes
    """(n,) place of the record that covers a segment; -1: the ledger has no record there."""
    share: Numbers
    """(n,) share of that record's length."""
    is_counted: Flags
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
    def is_compared(self) -> Flags:
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


def _select(pairs: Numbers, sides: tuple[Side, Side], block: Codes, kept: Flags) -> Segments:
    chosen = [Side(side.ledger, side.record[kept], side.share[kept], side.is_counted[kept]) for side in sides]
    return Segments(pairs[kept], chosen[0], chosen[1], np.unique(block[kept], return_inverse=True)[1])


def _divide(top: Numbers, bottom: Numbers) -> Numbers:
    """Return the quotient; NaN where the divisor is not positive."""
    return np.divide(top, bottom, out=np.full(len(top), np.nan), where=bottom > 0)
