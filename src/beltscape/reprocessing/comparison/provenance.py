"""Provenance of two ledgers: program, settings, rig and belt by which each was measured, and their differences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from beltscape.reprocessing.comparison.ledger import Codes
from beltscape.reprocessing.comparison.segments import Segments, Side

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
        *(_encode(side, part, side.record[compared]) for side in (segments.first, segments.second)),
        strict=True,
    )
    kinds, place = np.unique(codes[0] * len(names[1]) + codes[1], return_inverse=True)
    lengths = np.bincount(place, segments.length_mm[compared], len(kinds))
    found: dict[tuple[str, str], float] = {}
    for kind, length in zip(kinds.tolist(), lengths.tolist(), strict=True):
        pair = names[0][kind // len(names[1])], names[1][kind % len(names[1])]
        found[pair] = found.get(pair, 0.0) + length
    return found


def _encode(side: Side, part: str, records: Codes) -> tuple[list[str], Codes]:
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
