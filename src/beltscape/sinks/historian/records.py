"""Records and their cross-sections in the database: as rows, compressed, and read back.

NaN is NULL. A cross-section is stored as heights in steps of 1/32 mm, as differences, deflated.
"""

from __future__ import annotations

import math
import sqlite3
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.ledger import QUALITIES, STANDINGS, BeltRecord, CrossSection, FlowRecord, SigmaParts

_NO_PARTS = SigmaParts()


class RecordRow(NamedTuple):
    """A record in the database: one value for each column, in this order; None is not known, or without a strip.

    The tables are created in `database`; day files have the same columns, some by longer names (`day_files`).
    """

    number: int
    run: int
    from_mm: float
    to_mm: float
    standing: int
    """Index of its standing."""
    reason: str
    wall_ns: int
    run_sigma: float | None
    cameras: int
    frame: str | None = None
    """None: there is no strip."""
    time_ns: int | None = None
    position: float | None = None
    strip_from: float | None = None
    strip_to: float | None = None
    area: float | None = None
    volume: float | None = None
    sigma: float | None = None
    speed: float | None = None
    density: float | None = None
    coverage: float | None = None
    single: float | None = None
    quality: int | None = None
    """Index of the strip's quality."""
    offset_mm: float = 0.0
    product: str = ""
    batch: int = 0
    common_sigma: float | None = None
    density_sigma: float | None = None
    edges_sigma: float | None = None
    """This and the next four: parts of the common σ; None: not known, as of a record of an older program."""
    holes_sigma: float | None = None
    drift_sigma: float | None = None
    faults_sigma: float | None = None
    scale_sigma: float | None = None
    """Older programs counted it among the faults."""


COLUMNS = RecordRow._fields
"""Names of the database's columns."""
INSERT = f"INSERT INTO records ({', '.join(COLUMNS)}) VALUES ({', '.join('?' * len(COLUMNS))})"
SELECT = f"SELECT {', '.join(f'records.{name}' for name in COLUMNS)} FROM records"


def to_row(record: BeltRecord) -> RecordRow:
    """Return a record's values by the database's columns."""
    row = RecordRow(
        number=int(record.number),
        run=int(record.run),
        from_mm=float(record.belt_mm[0]),
        to_mm=float(record.belt_mm[1]),
        standing=STANDINGS.index(record.standing),
        reason=record.reason,
        wall_ns=int(record.wall_ns),
        run_sigma=_number(record.run_sigma_mm3),
        cameras=int(record.cameras),
        offset_mm=float(record.offset_mm),
        product=record.product,
        batch=record.batch,
    )
    strip = record.strip
    if strip is None:
        return row
    parts = None if strip.sigma_parts == _NO_PARTS else strip.sigma_parts
    return row._replace(
        frame=strip.frame,
        time_ns=strip.time_ns,
        position=_number(strip.belt_position_mm),
        strip_from=_number(strip.strip_mm[0]),
        strip_to=_number(strip.strip_mm[1]),
        area=_number(strip.area_mm2),
        volume=_number(strip.volume_mm3),
        sigma=_number(strip.sigma_mm3),
        speed=_number(strip.speed_mm_s),
        density=_number(strip.density_kg_m3),
        coverage=_number(strip.coverage),
        single=_number(strip.single_coverage),
        quality=QUALITIES.index(strip.quality),
        common_sigma=_number(strip.common_sigma_mm3),
        density_sigma=_number(strip.density_sigma_kg_m3),
        edges_sigma=None if parts is None else _number(parts.edges_mm3),
        holes_sigma=None if parts is None else _number(parts.holes_mm3),
        drift_sigma=None if parts is None else _number(parts.drift_mm3),
        faults_sigma=None if parts is None else _number(parts.faults_mm3),
        scale_sigma=None if parts is None else _number(parts.scale_mm3),
    )


def from_row(values: Iterable[Any], section: CrossSection | None = None) -> BeltRecord:
    """Return the record of a row's values, in the order of the database's columns."""
    row = RecordRow._make(values)
    return BeltRecord(
        number=row.number,
        run=row.run,
        belt_mm=(row.from_mm, row.to_mm),
        standing=STANDINGS[row.standing],
        reason=row.reason,
        wall_ns=row.wall_ns,
        strip=None if row.frame is None else _make_strip(row),
        run_sigma_mm3=_value(row.run_sigma),
        cameras=row.cameras,
        section=section,
        offset_mm=row.offset_mm,
        product=row.product,
        batch=row.batch,
    )


def _make_strip(row: RecordRow) -> FlowRecord:
    assert row.frame is not None and row.quality is not None  # every strip has both
    return FlowRecord(
        frame=row.frame,
        time_ns=row.time_ns,
        belt_position_mm=_value(row.position),
        strip_mm=(_value(row.strip_from), _value(row.strip_to)),
        area_mm2=_value(row.area),
        volume_mm3=_value(row.volume),
        sigma_mm3=_value(row.sigma),
        speed_mm_s=_value(row.speed),
        density_kg_m3=_value(row.density),
        coverage=_value(row.coverage),
        single_coverage=_value(row.single),
        quality=QUALITIES[row.quality],
        common_sigma_mm3=_value(row.common_sigma),
        density_sigma_kg_m3=_value(row.density_sigma),
        sigma_parts=_make_parts(row),
    )


def _make_parts(row: RecordRow) -> SigmaParts:
    """Return the parts of σ; what is not common is independent."""
    if row.edges_sigma is None:
        return _NO_PARTS
    apart = max(_value(row.sigma) ** 2 - _value(row.common_sigma) ** 2, 0.0)
    edges, holes, drift, faults = map(
        _value, (row.edges_sigma, row.holes_sigma, row.drift_sigma, row.faults_sigma)
    )
    return SigmaParts(apart, edges, holes, drift, faults, row.scale_sigma or 0.0)


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
