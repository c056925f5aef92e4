"""What the ledger adds up to, without loss over years: sums in twice the precision, checksummed text."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, replace
from zlib import crc32

from beltscape.core.belt.ledger_entries import BeltRecord, Totals

SUMS_BEGIN = re.compile(rb'\{"crc32": \d+, "sums": \{')
"""How the text of sums begins."""
Pair = tuple[float, float]
"""A sum and what rounding took from it."""


def plus(pair: Pair, value: float) -> Pair:
    """One more value in the sum (T. J. Dekker 1971, doi:10.1007/BF01397083: error-free addition)."""
    high = pair[0] + value
    part = high - pair[0]
    low = pair[1] + ((pair[0] - (high - part)) + (value - part))
    whole = high + low
    return whole, low - (whole - high)


@dataclass(frozen=True, slots=True)
class Sums:
    """The end of the ledger and its totals, exact enough to go on for ever."""

    number: int = 0
    """Of the last record; 0 while there is none."""
    run: int = 0
    end_mm: float | None = None
    offset_mm: float = 0.0
    """Of the last record."""
    since_ns: int | None = None
    volume_mm3: Pair = (0.0, 0.0)
    mass_kg: Pair = (0.0, 0.0)
    """Of what has a density."""
    unweighed: int = 0
    """Records with a load whose density is not known."""
    valid_mm: Pair = (0.0, 0.0)
    degraded_mm: Pair = (0.0, 0.0)
    missing_mm: Pair = (0.0, 0.0)
    sigma_before_mm3: float = 0.0
    """Of all runs before; they are added: what errors have in common stays from run to run."""
    sigma_run_mm3: float = 0.0
    """Of this run."""

    def with_record(self, record: BeltRecord) -> Sums:
        """One more record."""
        volume, mass = record_volume_mm3(record), record_mass_kg(record)
        lengths = {f"{record.standing}_mm": plus(getattr(self, f"{record.standing}_mm"), record.length_mm)}
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
            volume_mm3=plus(self.volume_mm3, volume),
            mass_kg=self.mass_kg if math.isnan(mass) else plus(self.mass_kg, mass),
            unweighed=self.unweighed + math.isnan(mass),
            sigma_before_mm3=before,
            sigma_run_mm3=last if math.isnan(sigma) else sigma,
            **lengths,
        )

    @property
    def totals(self) -> Totals:
        """As everyone sees them."""
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
        """JSON with a checksum; floats read back exactly."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        body = json.dumps(values, sort_keys=True)
        return json.dumps({"sums": values, "crc32": crc32(body.encode())}, sort_keys=True)


def read_sums(text: str) -> Sums | None:
    """The sums of ``Sums.text``; None where the text is damaged."""
    try:
        document = json.loads(text)
        values = document["sums"]
        if crc32(json.dumps(values, sort_keys=True).encode()) != document["crc32"]:
            return None
        return Sums(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})
    except (ValueError, TypeError, KeyError):
        return None


def sums_at(data: bytes) -> Sums | None:
    """The sums whose text ``data`` begins with, whatever follows; None where it is none or damaged."""
    try:
        text = data.decode("latin-1")
        return read_sums(text[: json.JSONDecoder().raw_decode(text)[1]])
    except ValueError:
        return None


def record_volume_mm3(record: BeltRecord) -> float:
    """What it adds to the total; nothing where it has no number."""
    return 0.0 if math.isnan(record.volume_mm3) else float(record.volume_mm3)


def record_mass_kg(record: BeltRecord) -> float:
    """What it adds to the mass; NaN where there is a load and no density."""
    return float(record.mass_kg) if record_volume_mm3(record) else 0.0
