"""Writing of flow.csv, one row per frame of a moving belt."""

from __future__ import annotations

import math
from collections.abc import Sequence

from beltscape.core.ledger import FlowRecord
from beltscape.files.atomic import write_text
from beltscape.files.paths import AnyPath, as_path

_DIGITS = {
    "belt_position_mm": 4,
    "area_mm2": 3,
    "volume_mm3": 3,
    "volume_flow_m3_h": 6,
    "mass_flow_t_h": 6,
    "coverage": 4,
}
"""Columns of numbers, each a quantity of `FlowRecord`, and their digits behind the point: below any σ. Chosen."""
HEADER = ",".join(("frame", "timestamp_s", *_DIGITS, "quality"))


def format_flow_row(record: FlowRecord) -> str:
    """Return a record's row; unknown values are empty."""
    time = "" if record.time_ns is None else f"{record.time_ns * 1e-9:.6f}"
    values = ((getattr(record, name), digits) for name, digits in _DIGITS.items())
    texts = ("" if math.isnan(value) else f"{value:.{digits}f}" for value, digits in values)
    return ",".join([record.frame, time, *texts, record.quality])


def write_flow(path: AnyPath, records: Sequence[FlowRecord]) -> None:
    """Write the whole file, atomically."""
    path = as_path(path)
    write_text(path, "\n".join([HEADER, *map(format_flow_row, records)]) + "\n")
