"""Appending records to the ledger, with sections, sums and totals, in one transaction.

The ledger's sums have no rounding loss over years: double-double arithmetic, stored as text with a checksum. Sums by
minute and by hour, for fast charts of any period, are updated in the records' own transaction.
"""

from __future__ import annotations

import json
import math
import re
import sqlite3
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast
from zlib import crc32

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.ledger import BeltRecord, Totals
from beltscape.sinks.days import HOUR_NS
from beltscape.sinks.historian.production import add_to_production
from beltscape.sinks.historian.records import INSERT, pack_heights, to_row

SUMS_BEGIN = re.compile(rb'\{"crc32": \d+, "sums": \{')
"""Beginning of the text of sums."""
Pair = tuple[float, float]
"""A sum and its rounding error."""


def add_compensated(pair: Pair, value: float) -> Pair:
    """Add a value to a sum (T. J. Dekker 1971, doi:10.1007/BF01397083: error-free addition)."""
    high = pair[0] + value
    part = high - pair[0]
    low = pair[1] + ((pair[0] - (high - part)) + (value - part))
    whole = high + low
    return whole, low - (whole - high)


@dataclass(frozen=True, slots=True)
class LedgerTotals:
    """The end of the ledger and its totals."""

    number: int = 0
    """Number of the last record; 0 without records."""
    run: int = 0
    end_mm: float | None = None
    offset_mm: float = 0.0
    """Offset of the last record."""
    since_ns: int | None = None
    volume_mm3: Pair = (0.0, 0.0)
    mass_kg: Pair = (0.0, 0.0)
    """Mass of the records with a known density."""
    unweighed: int = 0
    """Number of records with a load of unknown density."""
    valid_mm: Pair = (0.0, 0.0)
    degraded_mm: Pair = (0.0, 0.0)
    missing_mm: Pair = (0.0, 0.0)
    sigma_before_mm3: float = 0.0
    """Sum of the σ of all earlier runs, whose errors are fully correlated."""
    sigma_run_mm3: float = 0.0
    """σ of this run."""

    def add_record(self, record: BeltRecord) -> LedgerTotals:
        """Return the sums with one more record."""
        volume, mass = get_volume_mm3(record), get_mass_kg(record)
        lengths = {
            f"{record.standing}_mm": add_compensated(getattr(self, f"{record.standing}_mm"), record.length_mm)
        }
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
            volume_mm3=add_compensated(self.volume_mm3, volume),
            mass_kg=self.mass_kg if math.isnan(mass) else add_compensated(self.mass_kg, mass),
            unweighed=self.unweighed + math.isnan(mass),
            sigma_before_mm3=before,
            sigma_run_mm3=last if math.isnan(sigma) else sigma,
            **lengths,
        )

    @property
    def totals(self) -> Totals:
        """The totals of the ledger."""
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
        """Return the sums as JSON with a checksum; floats read back exactly."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        body = json.dumps(values, sort_keys=True)
        return json.dumps({"sums": values, "crc32": crc32(body.encode())}, sort_keys=True)


def read_sums(text: str) -> LedgerTotals | None:
    """Return the sums of ``LedgerTotals.text``; None if the text is damaged."""
    try:
        document = json.loads(text)
        values: dict[str, Any] = document["sums"]
        if crc32(json.dumps(values, sort_keys=True).encode()) != document["crc32"]:
            return None
        pairs: dict[str, Any] = {
            k: tuple(cast("list[float]", v)) for k, v in values.items() if isinstance(v, list)
        }
        return LedgerTotals(**{**values, **pairs})
    except (ValueError, TypeError, KeyError):
        return None


def read_leading_sums(data: bytes) -> LedgerTotals | None:
    """Return the sums whose text ``data`` begins with, ignoring what follows; None if it is damaged or absent."""
    try:
        text = data.decode("latin-1")
        return read_sums(text[: json.JSONDecoder().raw_decode(text)[1]])
    except ValueError:
        return None


def get_volume_mm3(record: BeltRecord) -> float:
    """Return a record's contribution to the total volume; 0 for NaN."""
    return 0.0 if math.isnan(record.volume_mm3) else float(record.volume_mm3)


def get_mass_kg(record: BeltRecord) -> float:
    """Return a record's contribution to the total mass; NaN for a load of unknown density."""
    return float(record.mass_kg) if get_volume_mm3(record) else 0.0


BUCKET_WIDTH_NS = {"minutes": HOUR_NS // 60, "hours": HOUR_NS}
"""Tables of sums with their widths, finest first."""
ADDED_COLUMNS = (
    *("records", "volume", "mass", "unweighed", "valid", "degraded", "missing"),
    *("moved", "moved_kg", "run_mm", "run_s", "known", "covered", "measured"),
)
"""Columns that are added; the others are the least and greatest of ``first``, ``last`` and the flow."""
_BUCKET_COLUMNS = ("bucket", "first", "last", *ADDED_COLUMNS, "flow_low", "flow_high")

Bucket = list[Any]


def add_to_buckets(connection: sqlite3.Connection, records: Sequence[BeltRecord], shift_ns: int) -> None:
    """Add records to both tables within the open transaction; buckets begin at ``shift_ns``."""
    for table, width_ns in BUCKET_WIDTH_NS.items():
        buckets: dict[int, Bucket] = {}
        for record in records:
            place = (int(record.wall_ns) - shift_ns) // width_ns
            row = bucket_from_record(record)
            buckets[place] = row if place not in buckets else merge_buckets(buckets[place], row)
        upsert_buckets(connection, table, ((place, *row) for place, row in buckets.items()))
    add_to_production(connection, records)


def upsert_buckets(connection: sqlite3.Connection, table: str, rows: Iterable[Sequence[Any]]) -> None:
    """Add rows (bucket, then as ``bucket_from_record``) to the table's rows."""
    added = ", ".join(f"{name} = {name} + excluded.{name}" for name in ADDED_COLUMNS)
    connection.executemany(
        f"INSERT INTO {table} ({', '.join(_BUCKET_COLUMNS)}) VALUES ({', '.join('?' * len(_BUCKET_COLUMNS))}) "
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


def append_records(
    connection: sqlite3.Connection,
    sums: LedgerTotals,
    records: Sequence[BeltRecord],
    shift_ns: int,
    *,
    sections: bool,
) -> LedgerTotals:
    """Store all or none of the new ``records``; return the sums after them. They are on disk when this returns.

    Raises
    ------
    InputError
        When a record does not continue the ledger, or differs from the one stored under its number.
    sqlite3.Error
        When they cannot be written; nothing has changed then.
    """
    new = _select_new(connection, sums, records)
    if not new:
        return sums
    after = sums
    for record in new:
        after = after.add_record(record)
    with transaction(connection):
        connection.executemany(INSERT, map(to_row, new))
        if sections:
            _keep_sections(connection, new)
        add_to_buckets(connection, new, shift_ns)
        connection.execute("UPDATE ledger SET state = ?", (after.text(),))
    return after


class transaction:  # noqa: N801  (a context manager, used like a keyword)
    """Context manager that commits the whole block or nothing."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def __enter__(self) -> None:
        """Begin the transaction."""
        self._connection.execute("BEGIN IMMEDIATE")

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        """Commit, or roll back on any exception, that of the commit included."""
        try:
            if kind is None:
                self._connection.execute("COMMIT")
        finally:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")


def set_sums(connection: sqlite3.Connection, sums: LedgerTotals) -> None:
    """Let the ledger end, and add up, as ``sums`` says; within a transaction."""
    connection.execute(
        "UPDATE ledger SET number = ?, run = ?, end_mm = ?, state = ?",
        (sums.number, sums.run, sums.end_mm, sums.text()),
    )
    connection.execute("INSERT OR IGNORE INTO runs (run, wall_ns) VALUES (?, ?)", (sums.run, time.time_ns()))


def _select_new(
    connection: sqlite3.Connection, sums: LedgerTotals, records: Sequence[BeltRecord]
) -> list[BeltRecord]:
    """Return the records that are not stored yet, each checked to continue the previous one."""
    new: list[BeltRecord] = []
    number, end_mm = sums.number, sums.end_mm
    for record in records:
        if record.number <= sums.number:
            _require_same(connection, record)
            continue
        start, end = map(float, record.belt_mm)
        if record.number != number + 1:
            raise InputError(
                f"record {record.number}: the ledger continues with number {number + 1}; none may be missing"
            )
        if not (math.isfinite(start) and math.isfinite(end) and end >= start):
            raise InputError(
                f"record {number + 1}: its belt from {start!r} to {end!r} mm is no stretch that goes forward"
            )
        if end_mm is not None and start != end_mm:
            raise InputError(
                f"record {number + 1}: it begins at {start!r} mm, the ledger ends at {end_mm!r} mm; they must meet"
            )
        new.append(record)
        number, end_mm = number + 1, end
    return new


def _require_same(connection: sqlite3.Connection, record: BeltRecord) -> None:
    """Raise InputError if another stretch is stored under the record's number; removed ones are not checked."""
    stored = connection.execute(
        "SELECT from_mm, to_mm FROM records WHERE number = ?", (record.number,)
    ).fetchone()
    if stored is not None and stored != tuple(map(float, record.belt_mm)):
        raise InputError(
            f"record {record.number}: it is already stored for {stored[0]!r} to {stored[1]!r} mm, not "
            f"{record.belt_mm[0]!r} to {record.belt_mm[1]!r} mm; continue from the historian's ledger_end"
        )


def _keep_sections(connection: sqlite3.Connection, records: Sequence[BeltRecord]) -> None:
    grids: dict[bytes, int] = {}
    rows: list[tuple[int, int, bytes]] = []
    for record in records:
        if record.section is None:
            continue
        x = np.ascontiguousarray(record.section.x_mm, "<f4").tobytes()
        if x not in grids:
            grids[x] = _grid_number(connection, x)
        rows.append((record.number, grids[x], pack_heights(record.section.height_mm)))
    connection.executemany("INSERT INTO sections (number, grid, height) VALUES (?, ?, ?)", rows)


def _grid_number(connection: sqlite3.Connection, x: bytes) -> int:
    """Return the number of the grid, which is stored once for all its sections."""
    row = connection.execute("SELECT grid FROM grids WHERE x = ?", (x,)).fetchone()
    if row is None:
        return int(connection.execute("INSERT INTO grids (x) VALUES (?)", (x,)).lastrowid or 0)
    return int(row[0])
