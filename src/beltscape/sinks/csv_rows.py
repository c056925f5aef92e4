"""Reading of the CSV sink's rows back into ledger entries, for the recovery of a lost database."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from pathlib import Path

from beltscape.core.belt.flow_record import QUALITIES, FlowRecord
from beltscape.core.belt.ledger_entries import STANDINGS, BeltRecord
from beltscape.files.tables import flow_csv

FIRST_HEADER = f"{flow_csv.HEADER},number,run,belt_from_mm,belt_to_mm,standing,reason,cameras,wall_time_s"
"""Columns of files that earlier versions began."""
HEADER = f"{FIRST_HEADER},product,batch"
PATTERN = "????-??-??.csv"
"""Names of the files, one per day."""
_COLUMNS = HEADER.split(",")
TAIL = 1 << 16
"""Bytes at the end of a file that contain its last row; a row has some 300."""


def read_last_number(path: Path) -> int:
    """Return the number of the last complete row; 0 without one, or if the file is not the CSV sink's."""
    with path.open("rb") as file:
        header = file.readline().decode("utf-8", "replace").rstrip("\n")
        size = file.seek(0, io.SEEK_END)
        file.seek(max(0, size - TAIL))
        tail = file.read()
    rows = tail[: tail.rfind(b"\n") + 1].decode("utf-8", "replace").splitlines()
    is_ours = header in (HEADER, FIRST_HEADER)
    values = next(csv.reader(rows[-1:]), [""]) if is_ours and len(rows) > 1 else [""]
    number = dict(zip(_COLUMNS, values, strict=False)).get("number", "")
    return int(number) if number.isdecimal() else 0


def read_records(path: Path, after: int, relative_sigma: float) -> Iterator[BeltRecord]:
    """Yield the entries of a file with numbers above ``after``; they end before the first row that is damaged.

    The file has no σ: that of a strip is set to ``relative_sigma`` of its volume, that of its run is NaN.
    """
    with path.open(encoding="utf-8", errors="replace", newline="") as file:
        for row in csv.DictReader(file):
            try:
                if int(row["number"]) <= after:
                    continue
                record = _parse_record(row, relative_sigma)
            except (KeyError, TypeError, ValueError):
                return
            yield record


def _parse_record(row: dict[str, str], relative_sigma: float) -> BeltRecord:
    if row["standing"] not in STANDINGS:
        raise ValueError(row["standing"])
    belt_mm = float(row["belt_from_mm"]), float(row["belt_to_mm"])
    seconds, _, micros = row["wall_time_s"].partition(".")
    return BeltRecord(
        number=int(row["number"]),
        run=int(row["run"]),
        belt_mm=belt_mm,
        standing=row["standing"],
        reason=row["reason"],
        wall_ns=int(seconds) * 10**9 + int(micros) * 1000,
        strip=_parse_strip(row, belt_mm, relative_sigma) if row["frame"] else None,
        run_sigma_mm3=math.nan,
        cameras=int(row["cameras"]),
        section=None,
        product=row.get("product") or "",
        batch=int(row.get("batch") or 0),
    )


def _parse_strip(row: dict[str, str], belt_mm: tuple[float, float], relative_sigma: float) -> FlowRecord:
    if row["quality"] not in QUALITIES:
        raise ValueError(row["quality"])
    area, volume, flow = (_number(row[name]) for name in ("area_mm2", "volume_mm3", "volume_flow_m3_h"))
    mass_flow = _number(row["mass_flow_t_h"])
    return FlowRecord(
        frame=row["frame"],
        time_ns=round(float(row["timestamp_s"]) * 1e9) if row["timestamp_s"] else None,
        belt_position_mm=_number(row["belt_position_mm"]),
        strip_mm=belt_mm,
        area_mm2=area,
        volume_mm3=volume,
        sigma_mm3=relative_sigma * abs(volume),
        speed_mm_s=flow / (area * 3600e-9) if area else math.nan,
        density_kg_m3=mass_flow / flow * 1e3 if flow else math.nan,
        coverage=_number(row["coverage"]),
        single_coverage=math.nan,
        quality=row["quality"],
    )


def _number(text: str) -> float:
    return float(text) if text else math.nan
