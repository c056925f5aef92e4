"""Records and their cross-sections in the database: as rows, compressed, and read back.

NaN is NULL. A cross-section is stored as heights in steps of 1/32 mm, as differences, deflated.
"""

from __future__ import annotations

import math
import sqlite3
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.ledger import QUALITIES, STANDINGS, BeltRecord, CrossSection, FlowRecord, SigmaParts

_NO_PARTS = SigmaParts()

COLUMNS = (
    *("number", "run", "from_mm", "to_mm", "standing", "reason", "wall_ns", "run_sigma", "cameras"),
    *("frame", "time_ns", "position", "strip_from", "strip_to", "area", "volume", "sigma"),
    *("speed", "density", "coverage", "single", "quality", "offset_mm"),
    *("product", "batch", "common_sigma", "density_sigma"),
    *("edges_sigma", "holes_sigma", "drift_sigma", "faults_sigma"),
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
        return (*head, *[None] * 13, float(record.offset_mm), record.product, record.batch, *[None] * 6)
    return (
        *(*head, strip.frame, strip.time_ns, _number(strip.belt_position_mm)),
        *(_number(strip.strip_mm[0]), _number(strip.strip_mm[1]), _number(strip.area_mm2)),
        *(_number(strip.volume_mm3), _number(strip.sigma_mm3), _number(strip.speed_mm_s)),
        *(_number(strip.density_kg_m3), _number(strip.coverage), _number(strip.single_coverage)),
        QUALITIES.index(strip.quality),
        *(float(record.offset_mm), record.product, record.batch),
        *(_number(strip.common_sigma_mm3), _number(strip.density_sigma_kg_m3)),
        *_parts_to_row(strip.sigma_parts),
    )


def _parts_to_row(parts: SigmaParts) -> tuple[float | None, ...]:
    """Return the common parts of σ; NULL where they are not known, as of an older record."""
    if parts == _NO_PARTS:
        return (None,) * 4
    return tuple(map(_number, (parts.edges_mm3, parts.holes_mm3, parts.drift_mm3, parts.faults_mm3)))


def _parts_from_row(strip_sigma: float, common: float, row: Sequence[float | None]) -> SigmaParts:
    """Return the parts of σ; what is not common is independent."""
    if row[0] is None:
        return _NO_PARTS
    apart = max(strip_sigma**2 - common**2, 0.0)
    return SigmaParts(apart, *map(_value, row))


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
        strip=None if row[9] is None else _strip(row[9:22], row[25:31]),
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
        sigma_parts=_parts_from_row(sigma, _value(sigmas[0]), sigmas[2:]),
    )


def _number(value: float) -> float | None:
    value = float(value)
    return None if math.isnan(value) else value


def _value(stored: float | None) -> float:
    return math.nan if stored is None else stored


STEP_MM = 1 / 32
"""Heights are exact to half of that, far below a camera's resolution; the grid is stored exactly."""
_LIMIT_MM = 2.0**24
"""Largest height that fits: 16 km, which no belt reaches."""


def round_heights(height_mm: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return heights (Nx,) float32 rounded as they will read back; NaN stays NaN."""
    clipped = np.clip(height_mm.astype(np.float64), -_LIMIT_MM, _LIMIT_MM)
    return (np.rint(clipped / STEP_MM) * STEP_MM).astype(np.float32)


def pack_heights(height_mm: NDArray[np.float32]) -> bytes:
    """Compress heights (Nx,) float32, NaN = not measured, to bytes."""
    absent = np.isnan(height_mm)
    steps = np.rint(round_heights(np.where(absent, np.float32(0), height_mm)) / STEP_MM).astype(np.int64)
    # a hole repeats the last height: its difference is 0
    places = np.maximum.accumulate(np.where(absent, 0, np.arange(len(steps)))) if len(steps) else steps
    differences = np.diff(steps[places], prepend=0).astype("<i4")
    shuffled = differences.view(np.uint8).reshape(-1, 4).T
    return struct.pack("<I", len(steps)) + zlib.compress(
        np.packbits(absent).tobytes() + shuffled.tobytes(), level=6
    )


def unpack_heights(data: bytes) -> NDArray[np.float32]:
    """Return the heights (Nx,) float32 of ``pack_heights``; ValueError for invalid bytes."""
    try:
        (count,) = struct.unpack_from("<I", data)
        body = np.frombuffer(zlib.decompress(data[4:]), np.uint8)
    except (struct.error, zlib.error) as error:
        raise ValueError(str(error)) from error
    bits = (count + 7) // 8
    if len(body) != bits + 4 * count:
        raise ValueError(f"{len(body)} bytes for {count} heights")
    differences = np.ascontiguousarray(body[bits:].reshape(4, count).T).view("<i4")[:, 0]
    height = (np.cumsum(differences, dtype=np.int64) * STEP_MM).astype(np.float32)
    height[np.unpackbits(body[:bits], count=count).astype(bool)] = np.nan
    return height


_WITH_SECTIONS = SELECT.replace(" FROM records", ", grids.x, sections.height FROM records") + (
    " LEFT JOIN sections ON sections.number = records.number LEFT JOIN grids ON grids.grid = sections.grid"
)
_WHERE = (
    " WHERE records.number BETWEEN ? AND ? AND records.wall_ns >= ? AND records.wall_ns < ?"
    " ORDER BY records.number LIMIT ?"
)


def read_database_records(
    connection: sqlite3.Connection,
    numbers: tuple[int, int],
    times_ns: tuple[int, int],
    limit: int,
    *,
    sections: bool,
) -> Iterator[BeltRecord]:
    """Yield the records in a range of numbers (ends included) and times (end excluded), in order of their numbers."""
    rows = connection.execute(
        f"{_WITH_SECTIONS if sections else SELECT}{_WHERE}",
        (*numbers, *times_ns, limit),
    )
    width = len(COLUMNS)
    for row in rows:
        yield from_row(row[:width], decode_section(row[width:]) if sections else None)


def read_database_rows(
    connection: sqlite3.Connection, numbers: tuple[int, int], times_ns: tuple[int, int], limit: int
) -> tuple[list[Sequence[Any]], list[CrossSection | None]]:
    """Return the records of such a range as rows in the order of the columns, and their sections."""
    rows = connection.execute(f"{_WITH_SECTIONS}{_WHERE}", (*numbers, *times_ns, limit)).fetchall()
    width = len(COLUMNS)
    return [row[:width] for row in rows], [decode_section(row[width:]) for row in rows]


def read_database_section(connection: sqlite3.Connection, number: int) -> CrossSection | None:
    """Return the cross-section of a record; None without a stored one."""
    row = connection.execute(
        "SELECT grids.x, height FROM sections JOIN grids USING (grid) WHERE number = ?", (number,)
    ).fetchone()
    return None if row is None else decode_section(row)


def decode_section(row: Sequence[bytes | None]) -> CrossSection | None:
    """Return the cross-section of the two blobs; None without blobs."""
    x, height = row
    if x is None or height is None:
        return None
    return CrossSection(np.frombuffer(x, "<f4").astype(np.float32), unpack_heights(height))
