"""The records of a ledger, for comparison with those of another one."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path
from typing import Any

from beltscape.core.ledger import BeltRecord
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings


def read_records(folder: Path) -> list[tuple[Any, ...]]:
    """Return everything that records hold, except the run's number and the system clock's time."""
    historian = Historian(folder, HistorySettings(reserve_mib=1))
    records = historian.records(0, 2**62, 10_000, sections=True)
    historian.close()
    return [_list_values(record) for record in records]


def _list_values(record: BeltRecord) -> tuple[Any, ...]:
    section = None if record.section is None else record.section.height_mm.tobytes()
    strip = None if record.strip is None else repr(astuple(record.strip))
    return (
        record.number, record.belt_mm, record.standing, record.reason, strip, record.run_sigma_mm3,
        record.cameras, record.offset_mm, section, repr(record.mass_kg),
    )  # fmt: skip
