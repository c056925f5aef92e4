"""The export endpoint: records of a period as CSV or Parquet, streamed in batches of some thousand rows."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, HTTPException, Query
from fastapi.responses import StreamingResponse

from beltscape.core.ledger import BeltRecord
from beltscape.service.access import User, require_role
from beltscape.service.api.common import AppContext, WallMs, check_period, describe_refusals
from beltscape.service.api.history import MS_NS, map_history_errors
from beltscape.sinks.csv_sink import HEADER, format_csv_row
from beltscape.sinks.historian import Historian
from beltscape.sinks.historian.day_files import schema, to_table
from beltscape.sinks.historian.records import to_row

_ROWS, _SECTIONS = 2000, 500
"""Rows read from the historian at once, without and with cross-sections; it bounds the memory."""
_LONGEST_MS = 366 * 86_400_000
"""Longest period of one export: a leap year."""
Format = Literal["csv", "parquet"]
MEDIA_TYPES: dict[Format, str] = {
    "csv": "text/csv; charset=utf-8",
    "parquet": "application/vnd.apache.parquet",
}


def make_router(context: AppContext) -> APIRouter:
    """Return the route GET /api/export."""
    router = APIRouter(prefix="/api", tags=["history"])

    @router.get(
        "/export",
        response_class=StreamingResponse,
        responses=describe_refusals(503)
        | {200: {"content": {kind: {} for kind in MEDIA_TYPES.values()}, "description": "The table"}},
    )
    def export(
        _: Annotated[User, Depends(require_role("viewer"))],
        since_ms: WallMs,
        until_ms: WallMs,
        kind: Annotated[Format, Query(alias="format", description="Kind of table")] = "csv",
    ) -> StreamingResponse:
        """All records of at most a year."""
        check_period(since_ms, until_ms)
        if until_ms - since_ms > _LONGEST_MS:
            detail = [
                {
                    "loc": ["query", "until_ms"],
                    "msg": "more than a year after since_ms",
                    "type": "value_error",
                }
            ]
            raise HTTPException(422, detail)
        with map_history_errors():  # errors at the start give status 503 instead of a broken table
            context.history.records(since_ms * MS_NS, until_ms * MS_NS, 1)
        batches = _read_batches(
            context.history, since_ms * MS_NS, until_ms * MS_NS, sections=kind == "parquet"
        )
        content = format_csv(batches) if kind == "csv" else encode_parquet(batches)
        days = "_".join(
            datetime.fromtimestamp(ms / 1000, UTC).strftime("%Y%m%dT%H%M") for ms in (since_ms, until_ms)
        )
        headers = {"Content-Disposition": f'attachment; filename="beltscape_{days}.{kind}"'}
        return StreamingResponse(content, media_type=MEDIA_TYPES[kind], headers=headers)

    return router


def _read_batches(
    history: Historian, since_ns: int, until_ns: int, *, sections: bool
) -> Iterator[Sequence[BeltRecord]]:
    after, limit = 0, _SECTIONS if sections else _ROWS
    while records := history.records(since_ns, until_ns, limit, after, sections=sections):
        yield records
        after = records[-1].number


def format_csv(batches: Iterator[Sequence[BeltRecord]]) -> Iterator[str]:
    """Yield header and rows as in the CSV files of the running system."""
    yield f"{HEADER}\n"
    for records in batches:
        yield "".join(f"{format_csv_row(record)}\n" for record in records)


class _ByteBuffer(io.RawIOBase):
    """A write-only file that keeps its bytes until they are fetched."""

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


def encode_parquet(batches: Iterator[Sequence[BeltRecord]]) -> Iterator[bytes]:
    """Yield a Parquet file with the columns of the day files and cross-sections, one row group per batch."""
    import pyarrow.parquet as pq

    buffer = _ByteBuffer()
    with pq.ParquetWriter(buffer, schema(), compression="zstd") as writer:
        for records in batches:
            rows, sections = [to_row(record) for record in records], [record.section for record in records]
            writer.write_table(to_table(rows, sections))
            yield buffer.fetch()
    yield buffer.fetch()
