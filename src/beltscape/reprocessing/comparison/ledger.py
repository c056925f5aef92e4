"""The records of a history as columns, and the runs that wrote them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from sys import intern
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt.flow_record import QUALITIES
from beltscape.core.belt.ledger_entries import STANDINGS, BeltRecord
from beltscape.sinks.historian.reading.runs import Run

Numbers = NDArray[np.float64]
Codes = NDArray[np.int64]
Texts = NDArray[Any]
"""Texts as Python objects: in arrays of fixed width one long reason would widen all others."""

NO_TIME = np.iinfo(np.int64).min
"""Stands for a time that is not known: the least 64-bit integer, which no clock gives."""
MISSING = STANDINGS.index("missing")
"""Code of the standing of belt that was not measured: its place in `STANDINGS`."""
_MEASURED = ("belt_position_mm", "area_mm2", "volume_mm3", "sigma_mm3", "common_sigma_mm3", "speed_mm_s",
             "density_kg_m3", "density_sigma_kg_m3", "coverage", "single_coverage")  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class LedgerColumns:
    """n records in the ledger's order, a column per quantity; NaN: not known, or a record without a strip."""

    number: Codes
    """(n,) record numbers, ascending."""
    run: Codes
    """(n,) numbers of the runs that wrote them."""
    from_mm: Numbers
    to_mm: Numbers
    """(n,) beginning and end of each stretch by the ledger's count, ascending."""
    standing: Codes
    """(n,) place in `STANDINGS`."""
    reason: Texts
    """(n,) why a record is not valid; empty where it is."""
    product: Texts
    """(n,) product names."""
    frame: Texts
    """(n,) names of the frames; empty without a strip."""
    time_ns: Codes
    """(n,) trigger times; `NO_TIME`: not known."""
    quality: Codes
    """(n,) place in `QUALITIES`; -1 without a strip."""
    cameras: Codes
    """(n,) cameras with an image."""
    batch: Codes
    """(n,) batch numbers."""
    run_sigma_mm3: Numbers
    offset_mm: Numbers
    """(n,) the ledger's count minus the encoder's."""
    strip_from_mm: Numbers
    strip_to_mm: Numbers
    """(n,) the strip in the meter's own belt coordinate."""
    belt_position_mm: Numbers
    area_mm2: Numbers
    volume_mm3: Numbers
    sigma_mm3: Numbers
    common_sigma_mm3: Numbers
    speed_mm_s: Numbers
    density_kg_m3: Numbers
    density_sigma_kg_m3: Numbers
    coverage: Numbers
    single_coverage: Numbers
    """(n,) as in `FlowRecord`."""

    def __len__(self) -> int:
        return len(self.number)

    @property
    def length_mm(self) -> Numbers:
        """Return the length of each stretch."""
        return self.to_mm - self.from_mm

    @property
    def is_counted(self) -> NDArray[np.bool_]:
        """Return which records have a volume that the totals count."""
        return (self.standing != MISSING) & np.isfinite(self.volume_mm3)


@dataclass(frozen=True, slots=True, eq=False)
class ComparedLedger:
    """One side of a comparison."""

    folder: Path
    """The folder as the user named it."""
    columns: LedgerColumns
    runs: Mapping[int, Run]
    """Runs by number; a run without an entry has no known provenance."""


def make_columns(records: Iterable[BeltRecord]) -> LedgerColumns:
    """Return the columns of records in the ledger's order."""
    listed = list(records)
    strips = [record.strip for record in listed]

    def measured(name: str) -> Numbers:
        return _numbers([math.nan if strip is None else getattr(strip, name) for strip in strips])

    return LedgerColumns(
        number=_codes([record.number for record in listed]),
        run=_codes([record.run for record in listed]),
        from_mm=_numbers([record.belt_mm[0] for record in listed]),
        to_mm=_numbers([record.belt_mm[1] for record in listed]),
        standing=_codes([STANDINGS.index(record.standing) for record in listed]),
        reason=_texts([record.reason for record in listed]),
        product=_texts([record.product for record in listed]),
        frame=_texts(["" if strip is None else strip.frame for strip in strips]),
        time_ns=_codes(
            [NO_TIME if strip is None or strip.time_ns is None else strip.time_ns for strip in strips]
        ),
        quality=_codes([-1 if strip is None else QUALITIES.index(strip.quality) for strip in strips]),
        cameras=_codes([record.cameras for record in listed]),
        batch=_codes([record.batch for record in listed]),
        run_sigma_mm3=_numbers([record.run_sigma_mm3 for record in listed]),
        offset_mm=_numbers([record.offset_mm for record in listed]),
        strip_from_mm=_numbers([math.nan if strip is None else strip.strip_mm[0] for strip in strips]),
        strip_to_mm=_numbers([math.nan if strip is None else strip.strip_mm[1] for strip in strips]),
        **{name: measured(name) for name in _MEASURED},
    )


def concatenate_columns(parts: Sequence[LedgerColumns]) -> LedgerColumns:
    """Return the columns of all parts, one after the other."""
    names = LedgerColumns.__dataclass_fields__
    return LedgerColumns(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _numbers(values: Sequence[float]) -> Numbers:
    return np.array(values, np.float64)


def _codes(values: Sequence[int]) -> Codes:
    return np.array(values, np.int64)


def _texts(values: Sequence[str]) -> Texts:
    return np.array([intern(value) for value in values], object)
