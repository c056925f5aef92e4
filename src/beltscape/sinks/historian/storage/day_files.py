"""Day files in Parquet: ``days/2026-11-21.parquet``, and ``2026-11-21-2.parquet`` if that day was reopened."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import InputError, OutputError
from beltscape.files.documents.digest import hash_file
from beltscape.files.folders.durable import commit_file
from beltscape.sinks.historian.storage.day_table import NAMES, hash_table, schema, to_records

UNBOUNDED = 1 << 62
"""A number and a time (ns) above all others, as the end of a range; SQLite and Parquet hold 63 bits and a sign."""

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

_Content = TypeVar("_Content")
_KEY = b"beltscape"
_FORMAT = "beltscape-day/1"


@dataclass(frozen=True, slots=True)
class DayFile:
    """Summary of one day file."""

    name: str
    day: int
    """Days since 1970."""
    first: int
    last: int
    """Least and greatest record number; the file has all records of that day between them."""
    since_ns: int
    until_ns: int
    """Wall clock of the earliest and of the latest record."""
    records: int
    bytes: int
    sha256: str
    """Hash of the file; empty unless it has just been written."""


def write_day(path: Path, day: int, tables: Iterable[pa.Table]) -> DayFile:
    """Write the tables of one day, a row group each, and read them back before the file gets its name.

    Raises
    ------
    OutputError
        When it cannot be written, or differs when read back.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    temporary = path.with_name(f".{path.name}.part")
    digests: list[str] = []
    numbers: list[tuple[int, int, int, int, int]] = []
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with pq.ParquetWriter(
            temporary,
            schema(),
            compression="zstd",
            compression_level=6,
            use_dictionary=["standing", "reason", "quality", "section_x_mm.list.element"],
            column_encoding={"section_height_mm.list.element": "BYTE_STREAM_SPLIT"},
            write_statistics=["number", "wall_time"],
        ) as writer:
            for table in tables:
                digests.append(hash_table(table))
                number, wall = table["number"].to_numpy(), table["wall_time"].cast(pa.int64()).to_numpy()
                numbers.append((number[0], number[-1], wall.min(), wall.max(), table.num_rows))
                writer.write_table(table, row_group_size=max(1, table.num_rows))
            low, high, since, until, counts = zip(*numbers, strict=True)
            about: dict[str, Any] = {
                "format": _FORMAT,
                "day": day,
                "first": int(min(low)),
                "last": int(max(high)),
            }
            about |= {"since_ns": int(min(since)), "until_ns": int(max(until)), "records": sum(counts)}
            writer.add_key_value_metadata({_KEY: json.dumps(about, sort_keys=True).encode()})
        _verify(temporary, digests)
        sha256 = hash_file(temporary)
        commit_file(temporary, path)
    except (OSError, pa.ArrowException) as error:
        raise OutputError(
            f"{path}: cannot be written ({_reason(error)}); its records stay in the database"
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    return _make_day_file(path, about, sha256)


def read_summary(path: Path) -> DayFile:
    """Read a day file's summary from its footer; InputError if it is no day file."""
    return _with_parquet(path, lambda file: _make_day_file(path, _summary(file, path), ""))


def read_day(
    path: Path,
    numbers: tuple[int, int],
    times_ns: tuple[int, int] = (-UNBOUNDED, UNBOUNDED),
    limit: int = UNBOUNDED,
    *,
    sections: bool,
) -> list[BeltRecord]:
    """Return the first ``limit`` records in a range of numbers (ends included) and times (end excluded).

    InputError if the file is damaged.
    """
    import pyarrow as pa

    def read(file: pq.ParquetFile) -> list[BeltRecord]:
        records: list[BeltRecord] = []
        for table in _row_groups(file, numbers, None if sections else list(NAMES)):
            number, wall = table["number"].to_numpy(), table["wall_time"].cast(pa.int64()).to_numpy()
            is_selected = (number >= numbers[0]) & (number <= numbers[1])
            is_selected &= (wall >= times_ns[0]) & (wall < times_ns[1])
            records.extend(to_records(table.filter(pa.array(is_selected)).slice(0, limit - len(records))))
            if len(records) >= limit:
                break
        return records

    return _with_parquet(path, read)


def _verify(path: Path, digests: list[str]) -> None:
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        written = [hash_table(file.read_row_group(place)) for place in range(file.num_row_groups)]
    if written != digests:
        raise OSError("it does not read back as it was written")


def _row_groups(
    file: pq.ParquetFile, numbers: tuple[int, int], columns: list[str] | None
) -> Iterator[pa.Table]:
    """Yield the row groups that may contain numbers of the range."""
    for place in range(file.num_row_groups):
        statistics = file.metadata.row_group(place).column(0).statistics
        if statistics is None or (statistics.min <= numbers[1] and statistics.max >= numbers[0]):
            yield file.read_row_group(place, columns=columns)


def _with_parquet(path: Path, read: Callable[[pq.ParquetFile], _Content]) -> _Content:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            return read(file)
    except FileNotFoundError:
        raise
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise InputError(
            f"{path}: not a readable day file ({_reason(error)}); restore it from a backup"
        ) from error


def _summary(file: pq.ParquetFile, path: Path) -> dict[str, Any]:
    about = json.loads((file.metadata.metadata or {}).get(_KEY, b"{}"))
    if about.get("format") != _FORMAT:
        raise InputError(f"{path}: not a day file of beltscape; move it away")
    return about


def _make_day_file(path: Path, about: dict[str, Any], sha256: str) -> DayFile:
    values = {name: int(value) for name, value in about.items() if name != "format"}
    return DayFile(name=path.name, bytes=path.stat().st_size, sha256=sha256, **values)


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or " ".join(str(error).split())
