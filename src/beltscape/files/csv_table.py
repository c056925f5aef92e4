"""Reading of small CSV files with a fixed header, and appending of rows to them."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.files.paths import parse_decimal, read_text

_POINTS = "write numbers with a decimal point"
_SEPARATORS = f": separate the columns by commas and {_POINTS}"


@dataclass(frozen=True, slots=True)
class CsvRow:
    """One row of a CSV file with its position."""

    name: str
    """Path or address of the file."""
    number: int
    """Number of the line in the file, from 1."""
    values: tuple[str, ...]

    def parse_number(self, column: int, name: str) -> float:
        """Return a finite number; InputError with file, line and value otherwise."""
        text = self.values[column]
        value = parse_decimal(text)
        if value is None:
            fix = (
                f"; write {text.replace(',', '.')}"
                if parse_decimal(text.replace(",", ".")) is not None
                else ""
            )
            raise InputError(f"{self.name}: line {self.number}: {name} {text!r} is not a number{fix}")
        return value

    def error(self, what: str) -> InputError:
        """Return an InputError with file and line."""
        return InputError(f"{self.name}: line {self.number}: {what}")


def read_csv(path: Path, header: Sequence[str], optional: Sequence[str] = ()) -> list[CsvRow]:
    """Return the rows of a CSV file with exactly this header (the ``optional`` columns may follow).

    Raises
    ------
    InputError
        When the file cannot be read, its header differs, a row has another number of values, or there is no row.
    """
    return parse_csv(read_text(path), str(path), header, optional)


def parse_csv(text: str, file: str, header: Sequence[str], optional: Sequence[str] = ()) -> list[CsvRow]:
    """Return the rows of a CSV file's text as `read_csv`; messages name the ``file``."""
    try:
        rows = list(csv.reader(io.StringIO(text)))
    except csv.Error as error:
        raise InputError(f"{file}: is no CSV table ({error})") from error
    wanted = ",".join(header) + "".join(f"[,{name}]" for name in optional)
    present = tuple(cell.strip() for cell in rows[0]) if rows else ()
    columns = (*header, *optional)
    if present not in {columns[:k] for k in range(len(header), len(columns) + 1)}:
        fix = "" if len(present) > 1 or not set(";\t") & set("".join(present)) else _SEPARATORS
        raise InputError(f"{file}: the header is {','.join(present)!r}; it must be {wanted}{fix}")
    lines: list[CsvRow] = []
    for number, row in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(present):
            fix = f"; decimal commas? {_POINTS}" if len(row) > len(present) else ""
            fix = _SEPARATORS if len(row) < len(present) and ";" in "".join(row) else fix
            raise InputError(
                f"{file}: line {number}: {len(row)} values, but the header has {len(present)}{fix}"
            )
        lines.append(CsvRow(file, number, tuple(cell.strip() for cell in row)))
    if not lines:
        raise InputError(f"{file}: no row below the header {wanted}")
    return lines


def append_rows(path: Path, header: str, rows: bytes) -> int:
    """Append all or none of the rows to a file, which gets its header first; return the bytes written."""
    start = path.stat().st_size if path.exists() else 0
    data = rows if start else f"{header}\n".encode() + rows
    size = len(data)
    try:
        with path.open("ab", buffering=0) as file:
            while data:
                data = data[file.write(data) :]
    except OSError:
        if path.exists():
            with path.open("r+b") as file:
                file.truncate(start)
        raise
    return size
