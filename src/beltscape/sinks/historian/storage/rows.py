"""Conversion between records and rows of the database's table; NaN is NULL."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from beltscape.core.belt.flow_record import QUALITIES, FlowRecord
from beltscape.core.belt.ledger_entries import STANDINGS, BeltRecord, CrossSection

COLUMNS = (
    *("number", "run", "from_mm", "to_mm", "standing", "reason", "wall_ns", "run_sigma", "cameras"),
    *("frame", "time_ns", "position", "strip_from", "strip_to", "area", "volume", "sigma"),
    *("speed", "density", "coverage", "single", "quality", "offset_mm"),
    *("product", "batch", "common_sigma", "density_sigma"),
)
INSERT = f"INSERT INTO records ({', '.join(COLUMNS)}) VALUES ({', '.join('?' * len(COLUMNS))})"
SELECT = f"SELECT {', '.join(f'records.{name}' for name in COLUMNS)} FROM records"


def to_row(record: BeltRecord) -> tuple[Any, ...]:
    """Return a record's values in the order of COLUMNS."""
    head = (
        *(int(record.number), int(record.run), *map(float, record.belt_mm), STANDINGS.index(record.standing)),
        *(record.reason, int(record.wall_ns), _number(record.run_sigma_mm3), int(record.cameras)),
    )
    strip = record.strip
    if strip is None:
        return (*head, *[None] * 13, float(record.offset_mm), record.product, record.batch, None, None)
    return (
        *(*head, strip.frame, strip.time_ns, _number(strip.belt_position_mm)),
        *(_number(strip.strip_mm[0]), _number(strip.strip_mm[1]), _number(strip.area_mm2)),
        *(_number(strip.volume_mm3), _number(strip.sigma_mm3), _number(strip.speed_mm_s)),
        *(_number(strip.density_kg_m3), _number(strip.coverage), _number(strip.single_coverage)),
        QUALITIES.index(strip.quality),
        *(float(record.offset_mm), record.product, record.batch),
        *(_number(strip.common_sigma_mm3), _number(strip.density_sigma_kg_m3)),
    )


def from_row(row: Sequence[Any], section: CrossSection | None = None) -> BeltRecord:
    """Return the record of a row in the order of COLUMNS."""
    number, run, start, end, standing, reason, wall_ns, run_sigma, cameras = row[:9]
    standing_index: int = standing
    return BeltRecord(
        number=number,
        run=run,
        belt_mm=(start, end),
        standing=STANDINGS[standing_index],
        reason=reason,
        wall_ns=wall_ns,
        strip=None if row[9] is None else _strip(row[9:22], row[25:27]),
        run_sigma_mm3=_value(run_sigma),
        cameras=cameras,
        section=section,
        offset_mm=row[22],
        product=row[23],
        batch=row[24],
    )


def _strip(row: Sequence[Any], sigmas: Sequence[float | None]) -> FlowRecord:
    frame, time_ns = row[:2]
    quality_index: int = row[12]
    position, start, end, area, volume, sigma, speed, density, coverage, single = map(_value, row[2:12])
    return FlowRecord(
        frame=frame,
        time_ns=time_ns,
        belt_position_mm=position,
        strip_mm=(start, end),
        area_mm2=area,
        volume_mm3=volume,
        sigma_mm3=sigma,
        speed_mm_s=speed,
        density_kg_m3=density,
        coverage=coverage,
        single_coverage=single,
        quality=QUALITIES[quality_index],
        common_sigma_mm3=_value(sigmas[0]),
        density_sigma_kg_m3=_value(sigmas[1]),
    )


def _number(value: float) -> float | None:
    value = float(value)
    return None if math.isnan(value) else value


def _value(stored: float | None) -> float:
    return math.nan if stored is None else stored
