"""Writing of flow.csv, one row per frame of a moving belt."""

from __future__ import annotations

import math
from collections.abc import Sequence

from beltscape.core.ledger import FlowRecord
from beltscape.files.atomic import write_text
from beltscape.files.paths import AnyPath, as_path

HEADER = (
    "frame,timestamp_s,belt_position_mm,area_mm2,volume_mm3,volume_flow_m3_h,mass_flow_t_h,coverage,quality"
)


def format_flow_row(record: FlowRecord) -> str:
    """Return a record's row; unknown values are empty."""
    time = "" if record.time_ns is None else f"{record.time_ns * 1e-9:.6f}"
    numbers = (
        (record.belt_position_mm, 4),
        (record.area_mm2, 3),
        (record.volume_mm3, 3),
        (record.volume_flow_m3_h, 6),
        (record.mass_flow_t_h, 6),
        (record.coverage, 4),
    )
    texts = ("" if math.isnan(value) else f"{value:.{digits}f}" for value, digits in numbers)
    return ",".join([record.frame, time, *texts, record.quality])


def write_flow(path: AnyPath, records: Sequence[FlowRecord]) -> None:
    """Write the whole file, atomically."""
    path = as_path(path)
    write_text(path, "\n".join([HEADER, *map(format_flow_row, records)]) + "\n")
