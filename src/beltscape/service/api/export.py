"""Records of a period as a table, streamed: CSV or Parquet, a few thousand rows in memory at a time."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from math import isnan
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, HTTPException, Query
from fastapi.responses import StreamingResponse

from beltscape.core.belt_record import BeltRecord
from beltscape.service.access import User, needs
from beltscape.service.api.common import Behind, WallMs, not_before, refusals
from beltscape.service.api.history import MS_NS, readable
from beltscape.sinks.historian import Historian

_ROWS = 2000
_LONGEST_MS = 366 * 86_400_000
Format = Literal["csv", "parquet"]
MEDIA_TYPES: dict[Format, str] = {
    "csv": "text/csv; charset=utf-8",
    "parquet": "application/vnd.apache.parquet",
}


def _of_strip(name: str) -> Callable[[BeltRecord], Any]:
    return lambda record: None if record.strip is None else getattr(record.strip, name)


COLUMNS: dict[str, tuple[str, Callable[[BeltRecord], Any]]] = {
    "number": ("int64", lambda record: record.number),
    "run": ("int64", lambda record: record.run),
    "wall_ns": ("int64", lambda record: record.wall_ns),
    "from_mm": ("float64", lambda record: record.belt_mm[0]),
    "to_mm": ("float64", lambda record: record.belt_mm[1]),
    "standing": ("string", lambda record: record.standing),
    "reason": ("string", lambda record: record.reason),
    "frame": ("string", _of_strip("frame")),
    "area_mm2": ("float64", _of_strip("area_mm2")),
    "volume_mm3": ("float64", lambda record: record.volume_mm3),
    "sigma_mm3": ("float64", lambda record: record.sigma_mm3),
    "speed_mm_s": ("float64", _of_strip("speed_mm_s")),
    "density_kg_m3": ("float64", _of_strip("density_kg_m3")),
    "volume_flow_m3_h": ("float64", _of_strip("volume_flow_m3_h")),
    "mass_flow_t_h": ("float64", _of_strip("mass_flow_t_h")),
    "coverage": ("float64", _of_strip("coverage")),
    "quality": ("string", _of_strip("quality")),
    "cameras": ("int64", lambda record: record.cameras),
}
"""Name → type and where it comes from; what is not known is empty."""


def routes(behind: Behind) -> APIRouter:
    """GET /api/export."""
    router = APIRouter(prefix="/api", tags=["history"])

    @router.get(
        "/export",
        response_class=StreamingResponse,
        responses=refusals(503)
        | {200: {"content": {kind: {} for kind in MEDIA_TYPES.values()}, "description": "The table"}},
    )
    def export(
        _: Annotated[User, Depends(needs("viewer"))],
        since_ms: WallMs,
        until_ms: WallMs,
        kind: Annotated[Format, Query(alias="format", description="Kind of table")] = "csv",
    ) -> StreamingResponse:
        """All records of at most a year."""
        not_before(since_ms, until_ms)
        if until_ms - since_ms > _LONGEST_MS:
            detail = [
                {
                    "loc": ["query", "until_ms"],
                    "msg": "more than a year after since_ms",
                    "type": "value_error",
                }
            ]
            raise HTTPException(422, detail)
        with readable():  # what is wrong from the start is said by the answer's code
            behind.history.records(since_ms * MS_NS, until_ms * MS_NS, 1)
        batches = _batches(behind.history, since_ms * MS_NS, until_ms * MS_NS)
        made = csv_text(batches) if kind == "csv" else parquet(batches)
        days = "_".join(
            datetime.fromtimestamp(ms / 1000, UTC).strftime("%Y%m%dT%H%M") for ms in (since_ms, until_ms)
        )
        headers = {"Content-Disposition": f'attachment; filename="beltscape_{days}.{kind}"'}
        return StreamingResponse(made, media_type=MEDIA_TYPES[kind], headers=headers)

    return router


def _batches(history: Historian, since_ns: int, until_ns: int) -> Iterator[Sequence[BeltRecord]]:
    after = 0
    while records := history.records(since_ns, until_ns, _ROWS, after):
        yield records
        after = records[-1].number


def _cell(value: Any) -> Any:
    """Nothing for NaN."""
    return None if isinstance(value, float) and isnan(value) else value


def csv_text(batches: Iterator[Sequence[BeltRecord]]) -> Iterator[str]:
    """Rows with a heading; lines end as RFC 4180 wants."""
    text = io.StringIO(newline="")
    table = csv.writer(text)
    table.writerow(COLUMNS)
    for records in batches:
        table.writerows([_cell(of(record)) for _, of in COLUMNS.values()] for record in records)
        yield text.getvalue()
        text.seek(0)
        text.truncate()
    yield text.getvalue()


class _Pipe(io.RawIOBase):
    """Takes what a writer writes until it is fetched."""

    def __init__(self) -> None:
        super().__init__()
        self._parts: list[bytes] = []
        self._at = 0

    def writable(self) -> bool:
        return True

    def write(self, data: Any, /) -> int:
        self._parts.append(bytes(data))
        self._at += len(self._parts[-1])
        return len(self._parts[-1])

    def tell(self) -> int:
        return self._at

    def fetch(self) -> bytes:
        data = b"".join(self._parts)
        self._parts.clear()
        return data


def parquet(batches: Iterator[Sequence[BeltRecord]]) -> Iterator[bytes]:
    """One row group a batch."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pa.schema([(name, getattr(pa, kind)()) for name, (kind, _) in COLUMNS.items()])
    pipe = _Pipe()
    with pq.ParquetWriter(pipe, schema, compression="zstd") as writer:
        for records in batches:
            columns = [[_cell(of(record)) for record in records] for _, of in COLUMNS.values()]
            arrays = [pa.array(values, field.type) for values, field in zip(columns, schema, strict=True)]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            yield pipe.fetch()
    yield pipe.fetch()
