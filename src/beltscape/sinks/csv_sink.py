"""Writing of records as CSV, one file per day, with the columns of flow.csv and of the ledger.

The rows are read back into ledger entries for the recovery of a lost database.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from beltscape.core.errors import InputError, OutputError
from beltscape.core.ledger import QUALITIES, STANDINGS, BeltRecord, FlowRecord
from beltscape.files import flow_csv
from beltscape.files.csv_table import append_rows
from beltscape.sinks.days import compute_day, compute_shift_ns, format_day
from beltscape.sinks.settings import CsvSettings

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


_FLOW_COLUMNS = flow_csv.HEADER.count(",") + 1
"""Number of columns that the table shares with flow.csv of `measure flow`."""
_NUMBER = _FLOW_COLUMNS
"""Index of the column ``number``, the first of the ledger's."""
_QUOTED = 200
"""Number of characters of a wrong row that a message quotes."""


class CsvSink:
    """A ``RecordSink`` that writes CSV; every file has complete rows only, and every record once."""

    def __init__(self, path: Path, settings: CsvSettings) -> None:
        """Write to the folder ``path``; a row that a crash left incomplete is removed.

        Raises
        ------
        InputError
            When a file of that name has another header.
        OutputError
            When the folder cannot be written.
        """
        self._folder, self._settings = path, settings
        self._shift_ns = compute_shift_ns(settings.day_begins_utc_h)
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._files = {file: _repair(file) for file in path.glob(PATTERN)}
            self._last = max(self._files.values(), default=0)
        except OSError as error:
            raise _output_error(path, error) from error

    @property
    def last(self) -> int:
        """Number of the last record written; 0 without one. Records up to it may be passed again."""
        return self._last

    def write(self, records: Sequence[BeltRecord]) -> None:
        """Append new records; the operating system has them when the call returns.

        Raises
        ------
        OutputError
            When they cannot be written; the file is unchanged then.
        """
        new = [record for record in records if record.number > self._last]
        for day, group in groupby(new, lambda record: compute_day(record.wall_ns, self._shift_ns)):
            day_records = list(group)
            path = self._folder / f"{format_day(day)}.csv"
            try:
                header = _read_header(path) or HEADER
                format_row = _ROW_FORMATS[header]
                append_rows(
                    path, header, "".join(f"{format_row(record)}\n" for record in day_records).encode()
                )
            except OSError as error:
                raise _output_error(path, error) from error
            self._files[path] = self._last = day_records[-1].number
            self._remove_oldest()

    def close(self) -> None:
        """Do nothing: no file is open between calls."""

    def _remove_oldest(self) -> None:
        """Remove the oldest files by their record numbers, because the clock may be wrong."""
        while len(self._files) > self._settings.days:
            oldest = min(self._files, key=lambda path: self._files[path])
            oldest.unlink(missing_ok=True)
            del self._files[oldest]


def format_csv_row(record: BeltRecord) -> str:
    """Return a record's row without a line end; unknown values are empty."""
    return f"{_format_first_columns(record)},{_cell(record.product)},{record.batch or ''}"


def _format_first_columns(record: BeltRecord) -> str:
    """Return the row for a file that an earlier version began."""
    strip = record.strip
    if strip is None:
        flow = "," * (_FLOW_COLUMNS - 1) + "missing"
    else:
        flow = flow_csv.format_flow_row(replace(strip, frame=_cell(strip.frame)))
    ledger = (
        *(record.number, record.run, f"{record.belt_mm[0]:.4f}", f"{record.belt_mm[1]:.4f}", record.standing),
        *(
            _cell(record.reason),
            record.cameras,
            f"{record.wall_ns // 10**9}.{record.wall_ns % 10**9 // 1000:06d}",
        ),
    )
    return f"{flow},{','.join(map(str, ledger))}"


_ROW_FORMATS: Mapping[str, Callable[[BeltRecord], str]] = {
    HEADER: format_csv_row,
    FIRST_HEADER: _format_first_columns,
}


def _read_header(path: Path) -> str:
    """Return the first line of a file; empty without one."""
    if not path.exists():
        return ""
    with path.open("rb") as file:
        return file.readline().decode("utf-8", "replace").rstrip("\n")


def _cell(text: str) -> str:
    """Return the text as one CSV cell on one line."""
    out = io.StringIO()
    csv.writer(out, lineterminator="").writerow([re.sub(r"\s+", " ", text)])
    return out.getvalue() if text else ""


def _repair(path: Path) -> int:
    """Remove an incomplete last row; return the number of the last complete one, 0 without one."""
    with path.open("r+b") as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(max(0, size - TAIL))
        tail = file.read()
        end = tail.rfind(b"\n") + 1
        if end < len(tail):
            file.truncate(size - len(tail) + end)
        file.seek(0)
        header = file.readline().decode("utf-8", "replace").rstrip("\n")
    if header not in _ROW_FORMATS:
        if not header:
            return 0
        raise InputError(
            f"{path}: the header is {header[:_QUOTED]!r}; it must be {HEADER}: move the file away"
        )
    rows = tail[:end].decode("utf-8", "replace").splitlines()
    none: list[str] = []
    values = next(csv.reader(rows[-1:]), none) if len(rows) > 1 else none
    if values and not (len(values) == header.count(",") + 1 and values[_NUMBER].isdecimal()):
        raise InputError(f"{path}: its last row {rows[-1][:_QUOTED]!r} is no record; move the file away")
    return int(values[_NUMBER]) if values else 0


def _output_error(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"{path}: cannot be written ({error.strerror or error}); free some space or correct its permissions"
    )
