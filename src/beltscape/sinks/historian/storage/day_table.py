"""Conversion between records and the table of a day file: names with units, empty cells without a measurement."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from beltscape.core.belt.flow_record import QUALITIES
from beltscape.core.belt.ledger_entries import STANDINGS, BeltRecord, CrossSection
from beltscape.sinks.historian.storage.rows import from_row

if TYPE_CHECKING:
    import pyarrow as pa

NAMES = (
    *(
        "number",
        "run",
        "belt_from_mm",
        "belt_to_mm",
        "standing",
        "reason",
        "wall_time",
        "run_sigma_mm3",
        "cameras",
    ),
    *(
        "frame",
        "time_ns",
        "belt_position_mm",
        "strip_from_mm",
        "strip_to_mm",
        "area_mm2",
        "volume_mm3",
        "sigma_mm3",
    ),
    *("speed_mm_s", "density_kg_m3", "coverage", "single_coverage", "quality", "offset_mm"),
    *("product", "batch", "common_sigma_mm3", "density_sigma_kg_m3"),
)
"""Names of the columns, in the order of the database's."""
SECTION = ("section_x_mm", "section_height_mm")
"""Columns of the cross-section: two lists of the same length, NaN where not measured."""
ADDED_LATER: Mapping[str, float | int | str | None] = {
    "offset_mm": 0.0,
    "product": "",
    "batch": 0,
    "common_sigma_mm3": None,
    "density_sigma_kg_m3": None,
}
"""Values of columns that older files do not have."""
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
