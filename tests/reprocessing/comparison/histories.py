"""Pairs of synthetic ledgers: scaled volumes and densities, changed standings, missing stretches, moved counts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.ledger import BeltRecord, FlowRecord
from beltscape.reprocessing.comparison.comparison import Comparison, compare_ledgers
from beltscape.reprocessing.comparison.ledger import ComparedLedger, make_columns
from beltscape.sinks.historian import Historian
from beltscape.sinks.historian.events import Run
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import START_NS, ledger

PROVENANCE = {"program": "0.2.0", "rig": "a" * 64, "empty": "e" * 64, "settings": "5" * 64}
OTHER_RIG = PROVENANCE | {"rig": "b" * 64}
Records = list[BeltRecord]


def measured(count: int = 60) -> Records:
    """Records as tests/sinks/ledgers.py has them, with times since 1970 and with the shared part of σ."""
    out = [replace(record, section=None, offset_mm=0.0) for record in ledger(count, sections=False)]
    return with_strips(
        out,
        lambda strip: {"time_ns": START_NS + (strip.time_ns or 0), "common_sigma_mm3": 0.6 * strip.sigma_mm3},
    )


def with_strips(records: Sequence[BeltRecord], change: Callable[[FlowRecord], Mapping[str, Any]]) -> Records:
    """The same records with other values of their strips."""
    return [
        record
        if record.strip is None
        else replace(record, strip=replace(record.strip, **change(record.strip)))
        for record in records
    ]


def scaled(records: Sequence[BeltRecord], factor: float) -> Records:
    """Volumes and areas times a factor, as by another calibration."""
    return with_strips(
        records, lambda strip: {"volume_mm3": strip.volume_mm3 * factor, "area_mm2": strip.area_mm2 * factor}
    )


def noisy(records: Sequence[BeltRecord], seed: int = 1) -> Records:
    """Volumes with an error of the strips' own σ."""
    rng = np.random.default_rng(seed)
    return with_strips(
        records, lambda strip: {"volume_mm3": strip.volume_mm3 + rng.normal(0, 0.8 * strip.sigma_mm3)}
    )


def moved(records: Sequence[BeltRecord], by_mm: float) -> Records:
    """A ledger that began its count elsewhere."""
    return [
        replace(record, belt_mm=(record.belt_mm[0] + by_mm, record.belt_mm[1] + by_mm)) for record in records
    ]


def mark_missing(records: Sequence[BeltRecord], numbers: range) -> Records:
    """Records whose belt was not measured."""
    return [
        replace(record, standing="missing", reason="frames lost", strip=None)
        if record.number in numbers
        else record
        for record in records
    ]


def degraded(records: Sequence[BeltRecord], numbers: range) -> Records:
    """Records of which a camera is missing."""
    return [
        replace(record, standing="degraded", reason="cam3 is missing")
        if record.number in numbers and record.standing == "valid"
        else record
        for record in records
    ]


def as_ledger(
    records: Sequence[BeltRecord], name: str = "data", provenance: Mapping[str, str] = PROVENANCE
) -> ComparedLedger:
    """One side of a comparison, without files."""
    runs = {record.run: Run(record.run, START_NS, provenance) for record in records}
    return ComparedLedger(Path(name), make_columns(records), runs)


def compared(
    first: Sequence[BeltRecord],
    second: Sequence[BeltRecord],
    provenance: Mapping[str, str] = PROVENANCE,
    of_second: Mapping[str, str] | None = None,
) -> Comparison:
    """The comparison of two lists of records."""
    return compare_ledgers(
        as_ledger(first, "A", provenance),
        as_ledger(second, "B", provenance if of_second is None else of_second),
    )


def write_history(
    folder: Path, records: Sequence[BeltRecord], provenance: Mapping[str, str] = PROVENANCE
) -> Path:
    """A history on the disk, closed."""
    historian = Historian(folder, HistorySettings(reserve_mib=1))
    historian.begin_run(provenance)
    historian.write(records)
    historian.close()
    return folder
