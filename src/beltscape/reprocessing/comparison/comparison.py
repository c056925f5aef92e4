"""Comparison of two ledgers of the same belt: totals, flow, standings, and what they were measured by.

The provenance is program, settings, rig and belt by which each was measured. Two ledgers may be identical to the last
digit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.reprocessing.comparison.differences import (
    BeltPart,
    DifferencePattern,
    DifferingStretch,
    find_pattern,
    list_changed_standings,
    list_differing_stretches,
)
from beltscape.reprocessing.comparison.ledger import Codes, ComparedLedger, LedgerColumns, read_ledger
from beltscape.reprocessing.comparison.segments import Alignment, Segments, Side, align_ledgers, make_segments
from beltscape.reprocessing.comparison.uncertainty import (
    COVERAGE_FACTOR,
    Intervals,
    PairedSums,
    make_intervals,
    measure_with_same_rig,
    sum_masses,
    sum_volumes,
)

PARTS: Mapping[str, str] = {
    "program": "program",
    "rig": "rig",
    "empty": "empty belt",
    "settings": "settings of measuring",
    "density": "density",
    "product": "product",
}
"""What is compared → its words."""
_HASHED = ("rig", "empty", "settings")
"""Parts of which the SHA-256 is recorded."""
_DIGITS = 12
"""Digits of a SHA-256 that are shown: enough to tell the files of a plant apart, as of a commit."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """One of `PARTS` in both ledgers, on the belt that both count."""

    part: str
    pairs: Mapping[tuple[str, str], float]
    """(first ledger's value, second ledger's value) → length of belt in mm; an empty value is not recorded."""

    @property
    def first(self) -> Mapping[str, float]:
        """Return the first ledger's values with the length of belt of each, the longest first."""
        return self._sum(0)

    @property
    def second(self) -> Mapping[str, float]:
        """Return the second ledger's values with the length of belt of each, the longest first."""
        return self._sum(1)

    def _sum(self, side: int) -> Mapping[str, float]:
        found: dict[str, float] = {}
        for pair, length in self.pairs.items():
            found[pair[side]] = found.get(pair[side], 0.0) + length
        return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))

    @property
    def differing_mm(self) -> float:
        """Return the length of belt on which the values differ, or only one of them is recorded."""
        return sum(length for (one, other), length in self.pairs.items() if one != other)

    @property
    def sentence(self) -> str:
        """Return it in words."""
        words = PARTS[self.part]
        if set(self.pairs) <= {("", "")}:
            return f"{words}: none" if self.part == "product" else f"{words}: recorded in neither"
        if not self.differing_mm:
            return f"{words}: the same, {self._list(self.first)}"
        share = self.differing_mm / sum(self.pairs.values())
        part = "" if share == 1 else f" on {100 * share:.1f} % of the belt"
        return f"{words}: differs{part}, A {self._list(self.first)}, B {self._list(self.second)}"

    def _list(self, values: Mapping[str, float]) -> str:
        if len(values) == 1:
            return self._show(next(iter(values)))
        return " and ".join(
            f"{self._show(value)} ({length / 1000:.1f} m)" for value, length in values.items()
        )

    def _show(self, value: str) -> str:
        if not value:
            return "none" if self.part == "product" else "not recorded"
        return value[:_DIGITS] if self.part in _HASHED else value


def compare_provenance(segments: Segments) -> tuple[Provenance, ...]:
    """Return all parts of the provenance on the belt that both ledgers count."""
    return tuple(Provenance(part, _measure_pairs(segments, part)) for part in PARTS)


def _measure_pairs(segments: Segments, part: str) -> dict[tuple[str, str], float]:
    compared = segments.is_compared
    names, codes = zip(
        *(_encode_pairs(side, part, side.record[compared]) for side in (segments.first, segments.second)),
        strict=True,
    )
    kinds, place = np.unique(codes[0] * len(names[1]) + codes[1], return_inverse=True)
    lengths = np.bincount(place, segments.length_mm[compared], len(kinds))
    found: dict[tuple[str, str], float] = {}
    for kind, length in zip(kinds.tolist(), lengths.tolist(), strict=True):
        pair = names[0][kind // len(names[1])], names[1][kind % len(names[1])]
        found[pair] = found.get(pair, 0.0) + length
    return found


def _encode_pairs(side: Side, part: str, records: Codes) -> tuple[list[str], Codes]:
    """Return the values of a part, and the place of each record's value among them."""
    columns = side.columns
    if part == "density":
        values, codes = np.unique(columns.density_kg_m3[records], return_inverse=True)
        return [f"{value:.10g} kg/m³" if np.isfinite(value) else "" for value in values.tolist()], codes
    if part == "product":
        values, codes = np.unique(columns.product[records], return_inverse=True)
        return [str(value) for value in values.tolist()], codes
    values, codes = np.unique(columns.run[records], return_inverse=True)
    runs = [side.ledger.runs.get(number) for number in values.tolist()]
    return ["" if run is None else str(run.provenance.get(part, "")) for run in runs], codes


_NUMBERING = ("number", "run")
"""Columns that say nothing of the belt: they count records and starts of the program."""


def count_differing_values(first: LedgerColumns, second: LedgerColumns) -> Mapping[str, int]:
    """Return the columns in which two ledgers differ, each with the number of records; empty if they are identical.

    Numbers of records and runs and the wall clock do not count. Ledgers of different length differ in ``records``, by
    the difference of their numbers.
    """
    if len(first) != len(second):
        return {"records": abs(len(first) - len(second))}
    found: dict[str, int] = {}
    for name in LedgerColumns.__dataclass_fields__:
        one, other = getattr(first, name), getattr(second, name)
        if name in _NUMBERING:
            continue
        differs = one != other
        if one.dtype.kind == "f":
            differs &= ~(np.isnan(one) & np.isnan(other))
        if count := int(np.count_nonzero(differs)):
            found[name] = count
    return found


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
    pattern: DifferencePattern | None
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
