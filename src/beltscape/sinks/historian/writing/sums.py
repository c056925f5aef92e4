"""The ledger's sums without rounding loss over years: double-double arithmetic, stored as text with a checksum."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, replace
from typing import Any, cast
from zlib import crc32

from beltscape.core.belt.ledger_entries import BeltRecord, Totals

SUMS_BEGIN = re.compile(rb'\{"crc32": \d+, "sums": \{')
"""Beginning of the text of sums."""
Pair = tuple[float, float]
"""A sum and its rounding error."""


def add_compensated(pair: Pair, value: float) -> Pair:
    """Add a value to a sum (T. J. Dekker 1971, doi:10.1007/BF01397083: error-free addition)."""
    high = pair[0] + value
    part = high - pair[0]
    low = pair[1] + ((pair[0] - (high - part)) + (value - part))
    whole = high + low
    return whole, low - (whole - high)


@dataclass(frozen=True, slots=True)
class Sums:
    """The end of the ledger and its totals."""

    number: int = 0
    """Number of the last record; 0 without records."""
    run: int = 0
    end_mm: float | None = None
    offset_mm: float = 0.0
    """Offset of the last record."""
    since_ns: int | None = None
    volume_mm3: Pair = (0.0, 0.0)
    mass_kg: Pair = (0.0, 0.0)
    """Mass of the records with a known density."""
    unweighed: int = 0
    """Number of records with a load of unknown density."""
    valid_mm: Pair = (0.0, 0.0)
    degraded_mm: Pair = (0.0, 0.0)
    missing_mm: Pair = (0.0, 0.0)
    sigma_before_mm3: float = 0.0
    """Sum of the σ of all earlier runs, whose errors are fully correlated."""
    sigma_run_mm3: float = 0.0
    """σ of this run."""

    def add_record(self, record: BeltRecord) -> Sums:
        """Return the sums with one more record."""
        volume, mass = get_volume_mm3(record), get_mass_kg(record)
        lengths = {
            f"{record.standing}_mm": add_compensated(getattr(self, f"{record.standing}_mm"), record.length_mm)
        }
        before, last = self.sigma_before_mm3, self.sigma_run_mm3
        if record.run != self.run:
            before, last = before + last, 0.0
        sigma = float(record.run_sigma_mm3)
        return replace(
            self,
            number=int(record.number),
            run=int(record.run),
            end_mm=float(record.belt_mm[1]),
            offset_mm=float(record.offset_mm),
            since_ns=int(record.wall_ns) if self.since_ns is None else self.since_ns,
            volume_mm3=add_compensated(self.volume_mm3, volume),
            mass_kg=self.mass_kg if math.isnan(mass) else add_compensated(self.mass_kg, mass),
            unweighed=self.unweighed + math.isnan(mass),
            sigma_before_mm3=before,
            sigma_run_mm3=last if math.isnan(sigma) else sigma,
            **lengths,
        )

    @property
    def totals(self) -> Totals:
        """The totals of the ledger."""
        return Totals(
            records=self.number,
            volume_mm3=self.volume_mm3[0],
            sigma_mm3=self.sigma_before_mm3 + self.sigma_run_mm3,
            mass_kg=math.nan if self.unweighed else self.mass_kg[0],
            valid_mm=self.valid_mm[0],
            degraded_mm=self.degraded_mm[0],
            missing_mm=self.missing_mm[0],
            since_ns=self.since_ns,
        )

    def text(self) -> str:
        """Return the sums as JSON with a checksum; floats read back exactly."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        body = json.dumps(values, sort_keys=True)
        return json.dumps({"sums": values, "crc32": crc32(body.encode())}, sort_keys=True)


def read_sums(text: str) -> Sums | None:
    """Return the sums of ``Sums.text``; None if the text is damaged."""
    try:
        document = json.loads(text)
        values: dict[str, Any] = document["sums"]
        if crc32(json.dumps(values, sort_keys=True).encode()) != document["crc32"]:
            return None
        pairs: dict[str, Any] = {
            k: tuple(cast("list[float]", v)) for k, v in values.items() if isinstance(v, list)
        }
        return Sums(**{**values, **pairs})
    except (ValueError, TypeError, KeyError):
        return None


def read_leading_sums(data: bytes) -> Sums | None:
    """Return the sums whose text ``data`` begins with, ignoring what follows; None if it is damaged or absent."""
    try:
        text = data.decode("latin-1")
        return read_sums(text[: json.JSONDecoder().raw_decode(text)[1]])
    except ValueError:
        return None


def get_volume_mm3(record: BeltRecord) -> float:
    """Return a record's contribution to the total volume; 0 for NaN."""
    return 0.0 if math.isnan(record.volume_mm3) else float(record.volume_mm3)


def get_mass_kg(record: BeltRecord) -> float:
    """Return a record's contribution to the total mass; NaN for a load of unknown density."""
    return float(record.mass_kg) if get_volume_mm3(record) else 0.0
