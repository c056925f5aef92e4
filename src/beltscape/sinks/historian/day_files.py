"""Day files in Parquet: ``days/2026-11-21.parquet``, and ``2026-11-21-2.parquet`` if that day was reopened.

Their table has names with units, and empty cells without a measurement.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from beltscape.core.errors import InputError, OutputError
from beltscape.core.ledger import QUALITIES, STANDINGS, BeltRecord, CrossSection
from beltscape.files.atomic import commit_file
from beltscape.files.json_text import hash_file
from beltscape.sinks.historian.records import COLUMNS, RecordRow, from_row

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq


_RENAMED = {
    "from_mm": "belt_from_mm",
    "to_mm": "belt_to_mm",
    "wall_ns": "wall_time",
    "run_sigma": "run_sigma_mm3",
    "position": "belt_position_mm",
    "strip_from": "strip_from_mm",
    "strip_to": "strip_to_mm",
    "area": "area_mm2",
    "volume": "volume_mm3",
    "sigma": "sigma_mm3",
    "speed": "speed_mm_s",
    "density": "density_kg_m3",
    "single": "single_coverage",
    "common_sigma": "common_sigma_mm3",
    "density_sigma": "density_sigma_kg_m3",
    "edges_sigma": "edges_sigma_mm3",
    "holes_sigma": "holes_sigma_mm3",
    "drift_sigma": "drift_sigma_mm3",
    "faults_sigma": "faults_sigma_mm3",
    "scale_sigma": "scale_sigma_mm3",
}
"""The database's columns whose names here have units."""
NAMES = tuple(_RENAMED.get(name, name) for name in COLUMNS)
"""Names of the columns, in the order of the database's."""
SECTION = ("section_x_mm", "section_height_mm")
"""Columns of the cross-section: two lists of the same length, NaN where not measured."""
_FIRST_NAMES = NAMES[: NAMES.index("quality") + 1]
"""Columns of the first version, which every file has."""
ADDED_LATER: Mapping[str, float | int | str | None] = {
    _RENAMED.get(name, name): value
    for name, value in RecordRow._field_defaults.items()
    if _RENAMED.get(name, name) not in _FIRST_NAMES
}
"""Values of columns that older files do not have: those that the database gives to older records."""
WORDS = {"standing": STANDINGS, "quality": QUALITIES}


def schema() -> pa.Schema:
    """Return names and types of a day file's columns."""
    import pyarrow as pa

    kinds = {
        **dict.fromkeys(("number", "time_ns"), pa.int64()),
        **dict.fromkeys(("run", "cameras", "batch"), pa.int32()),
        **dict.fromkeys(("standing", "reason", "frame", "quality", "product"), pa.string()),
        "wall_time": pa.timestamp("ns", tz="UTC"),
    }
    columns = [pa.field(name, kinds.get(name, pa.float64())) for name in NAMES]
    return pa.schema([*columns, *(pa.field(name, pa.list_(pa.float32())) for name in SECTION)])


def to_table(rows: Sequence[Sequence[Any]], sections: Sequence[CrossSection | None]) -> pa.Table:
    """Return the table of rows, in the order of the database's columns, and their sections."""
    import pyarrow as pa

    columns: dict[str, Any] = {}
    for name, values in zip(NAMES, zip(*rows, strict=True), strict=True):
        words = WORDS.get(name)
        columns[name] = [None if v is None else words[v] for v in values] if words else list(values)
    columns[SECTION[0]] = [None if s is None else s.x_mm for s in sections]
    columns[SECTION[1]] = [None if s is None else s.height_mm for s in sections]
    return pa.table(columns, schema=schema())


def to_records(table: pa.Table) -> Iterator[BeltRecord]:
    """Yield the records of a table, with their sections if it has those columns."""
    import pyarrow as pa

    count = table.num_rows
    columns: list[Sequence[Any]] = []
    for name in NAMES:
        if name in ADDED_LATER and name not in table.column_names:
            columns.append([ADDED_LATER[name]] * count)
            continue
        column = table[name].cast(pa.int64()) if name == "wall_time" else table[name]
        words = WORDS.get(name)
        values = column.to_pylist()
        columns.append([None if v is None else words.index(v) for v in values] if words else values)
    sections = [
        list(_lists(table, name)) if name in table.column_names else [None] * count for name in SECTION
    ]
    for place, row in enumerate(zip(*columns, strict=True)):
        x, height = sections[0][place], sections[1][place]
        yield from_row(row, None if x is None or height is None else CrossSection(x, height))


def _lists(table: pa.Table, name: str) -> Iterator[Any]:
    """Yield each cell as (n,) float32, None for an empty one."""
    for chunk in cast("list[pa.ListArray]", table[name].chunks):
        for cell in chunk:
            yield (
                None
                if not cell.is_valid
                else np.array(cell.values.to_numpy(zero_copy_only=False), np.float32)
            )


def hash_table(table: pa.Table) -> str:
    """Return a checksum of the cells' values, independent of their layout in memory."""
    import pyarrow as pa

    sums = hashlib.sha256()
    for name in table.column_names:
        for chunk in (
            table[name].combine_chunks().chunks if table[name].num_chunks > 1 else table[name].chunks
        ):
            column = chunk
            sums.update(np.asarray(column.is_null()).tobytes())
            if pa.types.is_list(column.type):
                lists = cast("pa.ListArray", column)
                sums.update(np.asarray(lists.value_lengths().fill_null(-1)).tobytes())
                sums.update(np.asarray(lists.flatten(), np.float32).tobytes())
            elif pa.types.is_string(column.type):
                sums.update("\0".join(column.fill_null("").to_pylist()).encode())
            else:
                plain = column.cast(pa.int64()) if pa.types.is_timestamp(column.type) else column
                sums.update(np.asarray(plain.fill_null(0)).tobytes())
    return sums.hexdigest()


UNBOUNDED = 1 << 62
"""A number and a time (ns) above all others, as the end of a range; SQLite and Parquet hold 63 bits and a sign."""

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
