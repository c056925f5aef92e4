"""Comparison of two ledgers of the same belt: totals, flow, standings, and what they were measured by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.reprocessing.comparison.alignment import Alignment, align_ledgers
from beltscape.reprocessing.comparison.identity import count_differing_values
from beltscape.reprocessing.comparison.intervals import Intervals, make_intervals
from beltscape.reprocessing.comparison.ledger import ComparedLedger
from beltscape.reprocessing.comparison.pattern import Pattern, find_pattern
from beltscape.reprocessing.comparison.provenance import Provenance, compare_provenance
from beltscape.reprocessing.comparison.reading import read_ledger
from beltscape.reprocessing.comparison.reasons import BeltPart, list_changed_standings
from beltscape.reprocessing.comparison.segments import Segments, make_segments
from beltscape.reprocessing.comparison.stretches import DifferingStretch, list_differing_stretches
from beltscape.reprocessing.comparison.uncertainty import (
    COVERAGE_FACTOR,
    PairedSums,
    measure_with_same_rig,
    sum_masses,
    sum_volumes,
)


@dataclass(frozen=True, slots=True)
class PairedTotal:
    """One total of both ledgers on the belt that both count."""

    first: float
    first_sigma: float
    second: float
    second_sigma: float
    difference: float
    """Second minus first."""
    difference_sigma: float
    """One standard deviation of the difference; NaN: not known."""

    @property
    def agrees(self) -> bool | None:
        """Return whether the difference is within `COVERAGE_FACTOR` σ; None: σ is not known."""
        if not np.isfinite(self.difference_sigma):
            return None
        return abs(self.difference) <= COVERAGE_FACTOR * self.difference_sigma

    @property
    def relative(self) -> float:
        """Return the difference over the first total; NaN where that is 0."""
        return self.difference / self.first if self.first else float("nan")


@dataclass(frozen=True, slots=True)
class WholeLedger:
    """One ledger as a whole."""

    records: int
    length_mm: float
    missing_mm: float
    volume_mm3: float
    """All that it counts."""
    alone_mm: float
    """Belt that it counts and the other one does not."""
    alone_mm3: float
    """The volume on that belt."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """The result."""

    first: ComparedLedger
    second: ComparedLedger
    differing: Mapping[str, int]
    """Columns that differ → number of records; empty: identical to the last digit."""
    alignment: Alignment
    compared_mm: float
    """Belt that both count."""
    same_rig_mm: float
    """The part of it that both measured with the same rig and empty belt."""
    wholes: tuple[WholeLedger, WholeLedger]
    volume: PairedTotal
    """mm³."""
    mass: PairedTotal | None
    """kg; None where a density is not known."""
    without_density_mm: tuple[float, float]
    """Compared belt with a load of unknown density, by ledger."""
    intervals: Intervals
    changes: tuple[BeltPart, ...]
    """Belt with another standing, or without a record, on one side."""
    stretches: tuple[DifferingStretch, ...]
    """Those that differ most beyond their σ."""
    provenance: tuple[Provenance, ...]
    pattern: Pattern | None
    """What the differences of the intervals have in common; None: nothing."""

    @property
    def is_identical(self) -> bool:
        """Return whether all values of all records are the same to the last digit."""
        return not self.differing


def compare_histories(first: Path, second: Path, reporter: Reporter) -> Comparison:
    """Compare the histories in two folders, which stay as they are.

    Raises
    ------
    InputError
        If one of them cannot be read, or they share no frame or no belt.
    """
    return compare_ledgers(read_ledger(first, reporter), read_ledger(second, reporter))


def compare_ledgers(first: ComparedLedger, second: ComparedLedger) -> Comparison:
    """Compare two ledgers; InputError if they share no frame, or no belt that both count."""
    alignment = align_ledgers(first, second)
    segments = make_segments(first, second, alignment)
    compared = segments.is_compared
    if not compared.any():
        raise InputError(
            f"{first.folder} and {second.folder}: count no belt in common; nothing can be compared"
        )
    volumes, masses = sum_volumes(segments), sum_masses(segments)
    count = int(segments.block[-1]) + 1
    blocks = volumes.group(segments.block, count)
    intervals = make_intervals(segments, blocks)
    mass = _total(masses)
    return Comparison(
        first=first,
        second=second,
        differing=count_differing_values(first.columns, second.columns),
        alignment=alignment,
        compared_mm=float(segments.length_mm[compared].sum()),
        same_rig_mm=float(segments.length_mm[compared & measure_with_same_rig(segments)].sum()),
        wholes=_describe_wholes(segments),
        volume=_total(volumes),
        mass=mass if np.isfinite(mass.difference) else None,
        without_density_mm=_measure_without_density(segments, masses),
        intervals=intervals,
        changes=list_changed_standings(segments),
        stretches=list_differing_stretches(segments, blocks, intervals.of_block),
        provenance=compare_provenance(segments),
        pattern=find_pattern(intervals.volume),
    )


def _total(sums: PairedSums) -> PairedTotal:
    whole = sums.group(np.zeros(len(sums.length_mm), np.int64), 1)
    sigma = whole.sigma[:, 0]
    return PairedTotal(
        *(float(whole.value[0, 0]), float(sigma[0]), float(whole.value[1, 0]), float(sigma[1])),
        *(float((sums.value[1] - sums.value[0]).sum()), float(whole.difference_sigma[0])),
    )


def _measure_without_density(segments: Segments, masses: PairedSums) -> tuple[float, float]:
    first, second = (
        float(segments.length_mm[segments.is_compared & ~np.isfinite(row)].sum()) for row in masses.value
    )
    return first, second


def _describe_wholes(segments: Segments) -> tuple[WholeLedger, WholeLedger]:
    first, second = (
        WholeLedger(
            records=len(side.columns),
            length_mm=float(side.columns.length_mm.sum()),
            missing_mm=float(side.columns.length_mm[~side.columns.is_counted].sum()),
            volume_mm3=float(side.columns.volume_mm3[side.columns.is_counted].sum()),
            alone_mm=float(side.split(side.columns.length_mm)[~segments.is_compared].sum()),
            alone_mm3=float(side.split(side.columns.volume_mm3)[~segments.is_compared].sum()),
        )
        for side in (segments.first, segments.second)
    )
    return first, second
