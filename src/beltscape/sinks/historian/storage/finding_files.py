"""Day files of findings in Parquet: ``findings/2026-11-21.parquet``, a row group for each check and subject."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.core.errors import InputError, OutputError
from beltscape.core.live.findings import EFFECTS
from beltscape.files.folders.durable import commit_file

if TYPE_CHECKING:
    import pyarrow as pa

FindingRow = Sequence[Any]
"""Check, subject, unit, wall_ns, value, σ, limit, index of the effect, text."""
_FORMAT = b"beltscape-findings/1"
_DAY = b"beltscape-day"
_NUMBERS = ("value", "sigma", "limit")
_NAMES = ("check", "subject", "unit", "wall_time", *_NUMBERS, "effect", "text")


def _make_schema() -> pa.Schema:
    import pyarrow as pa

    kinds = {"wall_time": pa.timestamp("ns", tz="UTC"), **dict.fromkeys(_NUMBERS, pa.float64())}
    return pa.schema([pa.field(name, kinds.get(name, pa.string())) for name in _NAMES])


def write_finding_day(path: Path, day: int, series: Iterable[Sequence[FindingRow]]) -> int:
    """Write the rows of a day, a row group for each series, and return the file's size.

    Raises
    ------
    OutputError
        When it cannot be written, or has another number of rows when read back.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    temporary = path.with_name(f".{path.name}.part")
    schema, count = _make_schema(), 0
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
            for rows in series:
                columns = [list(column) for column in zip(*rows, strict=True)]
                columns[7] = [EFFECTS[effect] for effect in columns[7]]
                table = pa.table(dict(zip(_NAMES, columns, strict=True)), schema=schema)
                writer.write_table(table, row_group_size=len(rows))
                count += len(rows)
            writer.add_key_value_metadata({b"beltscape": _FORMAT, _DAY: str(day).encode()})
        with pq.ParquetFile(temporary) as file:
            if file.metadata.num_rows != count:
                raise OSError("it does not read back as it was written")
        commit_file(temporary, path)
    except (OSError, pa.ArrowException) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise OutputError(
            f"{path}: cannot be written ({reason}); its findings stay in the database"
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    return path.stat().st_size


def read_finding_day(path: Path) -> int:
    """Return the day of a file, days since 1970; InputError if it is no day file of findings."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            about = file.metadata.metadata or {}
        if about.get(b"beltscape") == _FORMAT:
            return int(about[_DAY])
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise InputError(f"{path}: not a readable file of findings; restore it from a backup") from error
    raise InputError(f"{path}: not a file of findings; move it away")


def read_findings(path: Path, check: str, subject: str, times_ns: tuple[int, int]) -> list[FindingRow]:
    """Return the rows of one series in a period (its end excluded); InputError if the file is damaged."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows: list[FindingRow] = []
    try:
        with pq.ParquetFile(path) as file:
            for place in range(file.num_row_groups):
                first = file.metadata.row_group(place).column(0).statistics
                if first is None or first.min <= check <= first.max:
                    rows += _list_rows(file.read_row_group(place))
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise InputError(f"{path}: not a readable file of findings; restore it from a backup") from error
    return [row for row in rows if row[:2] == (check, subject) and times_ns[0] <= row[3] < times_ns[1]]


def _list_rows(table: pa.Table) -> list[FindingRow]:
    import pyarrow as pa

    columns: dict[str, list[Any]] = {}
    for name in _NAMES:
        column = table[name].cast(pa.int64()) if name == "wall_time" else table[name]
        columns[name] = list(column.to_pylist())
    columns["effect"] = [EFFECTS.index(name) for name in columns["effect"]]
    return list(zip(*columns.values(), strict=True))
