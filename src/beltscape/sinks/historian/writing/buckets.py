"""Sums of records by minute and by hour, updated in the records' own transaction, for fast charts of any period."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterable, Sequence
from typing import Any

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.sinks.days import HOUR_NS
from beltscape.sinks.historian.writing.production import add_to_production
from beltscape.sinks.historian.writing.sums import get_mass_kg, get_volume_mm3

WIDTH_NS = {"minutes": HOUR_NS // 60, "hours": HOUR_NS}
"""Tables of sums with their widths, finest first."""
ADDED = (
    *("records", "volume", "mass", "unweighed", "valid", "degraded", "missing"),
    *("moved", "moved_kg", "run_mm", "run_s", "known", "covered", "measured"),
)
"""Columns that are added; the others are the least and greatest of ``first``, ``last`` and the flow."""
_COLUMNS = ("bucket", "first", "last", *ADDED, "flow_low", "flow_high")

Bucket = list[Any]


def add_to_buckets(connection: sqlite3.Connection, records: Sequence[BeltRecord], shift_ns: int) -> None:
    """Add records to both tables within the open transaction; buckets begin at ``shift_ns``."""
    for table, width_ns in WIDTH_NS.items():
        buckets: dict[int, Bucket] = {}
        for record in records:
            place = (int(record.wall_ns) - shift_ns) // width_ns
            row = bucket_from_record(record)
            buckets[place] = row if place not in buckets else merge_buckets(buckets[place], row)
        upsert(connection, table, ((place, *row) for place, row in buckets.items()))
    add_to_production(connection, records)


def upsert(connection: sqlite3.Connection, table: str, rows: Iterable[Sequence[Any]]) -> None:
    """Add rows (bucket, then as ``bucket_from_record``) to the table's rows."""
    added = ", ".join(f"{name} = {name} + excluded.{name}" for name in ADDED)
    connection.executemany(
        f"INSERT INTO {table} ({', '.join(_COLUMNS)}) VALUES ({', '.join('?' * len(_COLUMNS))}) "
        f"ON CONFLICT (bucket) DO UPDATE SET {added}, "
        "first = min(first, excluded.first), last = max(last, excluded.last), "
        "flow_low = min(coalesce(flow_low, excluded.flow_low), coalesce(excluded.flow_low, flow_low)), "
        "flow_high = max(coalesce(flow_high, excluded.flow_high), coalesce(excluded.flow_high, flow_high))",
        rows,
    )


def bucket_from_record(record: BeltRecord) -> Bucket:
    """Return one record's bucket: first, last, the columns of ADDED, least and greatest flow."""
    volume, mass, length = get_volume_mm3(record), get_mass_kg(record), float(record.length_mm)
    unweighed = math.isnan(mass)
    mass = 0.0 if unweighed else mass
    standing = [length if record.standing == name else 0.0 for name in ("valid", "degraded", "missing")]
    strip = record.strip
    flow = math.nan if strip is None else float(strip.volume_flow_m3_h)
    has_flow = not math.isnan(flow)
    # only a moving belt counts in time; a stopped one has a flow of 0
    moving = strip is not None and has_flow and strip.speed_mm_s > 0
    seconds = length / strip.speed_mm_s if moving and strip is not None else 0.0
    covered = strip is not None and not math.isnan(strip.coverage)
    return [
        *(int(record.number), int(record.number), 1, volume, mass, int(unweighed), *standing),
        *((volume, mass, length) if moving else (0.0, 0.0, 0.0)),
        *(seconds, int(has_flow)),
        *((strip.coverage * length, length) if covered and strip is not None else (0.0, 0.0)),
        *((flow, flow) if has_flow else (None, None)),
    ]


def merge_buckets(one: Bucket, other: Bucket) -> Bucket:
    """Return the sum of two buckets."""
    sums = [a + b for a, b in zip(one[2:-2], other[2:-2], strict=True)]
    lows = [v for v in (one[-2], other[-2]) if v is not None]
    highs = [v for v in (one[-1], other[-1]) if v is not None]
    return [
        min(one[0], other[0]),
        max(one[1], other[1]),
        *sums,
        min(lows, default=None),
        max(highs, default=None),
    ]
