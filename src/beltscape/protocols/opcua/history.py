"""Historical access (OPC 10000-11): raw values of the records, with status, from the historian.

A continuation point holds where the next page begins, so the server keeps nothing for a client that does not come
back, and records that bear the same time are neither lost nor repeated. Forwards the records come in the ledger's
order, backwards in the order of their times.
"""

from __future__ import annotations

import asyncio
import heapq
import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from asyncua import ua

from beltscape.core.ledger import BeltRecord
from beltscape.protocols.opcua.address_space import own_id
from beltscape.protocols.opcua.publication import make_count, make_value
from beltscape.protocols.opcua.quantities import QUANTITIES, RECORD_QUANTITIES, OpcUaQuantity, RecordQuantity
from beltscape.protocols.plant import Plant

_PAGE = 2000
"""Values in one answer, some 60 kB; further ones follow by a continuation point."""
_MOST = 10_000
"""Values in one answer to a client that asks for that many."""
_READ = 1000
"""Records that are read at once."""
_MARK = struct.Struct("<4sBqq")
"""A continuation point: mark, direction, time and number of the last record that was given."""
_MAGIC = b"BSC1"
_FIRST_WINDOW_NS = 60 * 10**9
"""First stretch of time that is searched backwards; each further one is eight times as long."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_OLDEST = datetime(1900, 1, 1, tzinfo=UTC)
"""Times before it stand for "not given": OPC UA counts from 1601."""
_END_OF_TIME_NS = 1 << 62
"""A time after every record."""
_MICROSECOND = timedelta(microseconds=1)
Encode = Callable[[BeltRecord], ua.DataValue]


@dataclass(frozen=True, slots=True)
class _Request:
    """A stretch of the history in ns since 1970, and the direction in which it is read."""

    since_ns: int
    until_ns: int
    """Excluded."""
    backwards: bool
    last: tuple[int, int] | None
    """Time and number of the last record of the page before."""
    count: int


class RecordHistory:
    """Answers reads of the history; it takes the place of the library's history manager."""

    def __init__(self, plant: Plant) -> None:
        """Serve the records of a plant."""
        self._plant = plant
        self._encoders: dict[ua.NodeId, Encode] = {}
        for quantity in QUANTITIES:
            if quantity.record is not None:
                self._encoders[own_id(quantity.path)] = _make_encoder(quantity)
        for quantity in RECORD_QUANTITIES:
            self._encoders[own_id(quantity.path)] = _make_record_encoder(quantity)

    async def init(self) -> None:
        """Do nothing: the historian is open."""

    async def stop(self) -> None:
        """Do nothing: the historian closes by itself."""

    def update_history(self, params: ua.HistoryUpdateParameters) -> list[ua.HistoryUpdateResult]:
        """Refuse: records are never changed."""
        refused = ua.StatusCode(ua.StatusCodes.BadHistoryOperationUnsupported)
        return [ua.HistoryUpdateResult(StatusCode=refused) for _ in params.HistoryUpdateDetails]

    async def read_history(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        """Return a page of raw values for every node."""
        if params.ReleaseContinuationPoints:
            return [ua.HistoryReadResult() for _ in params.NodesToRead]
        details = params.HistoryReadDetails
        return [await self._read_node(details, node) for node in params.NodesToRead]

    async def _read_node(self, details: object, node: ua.HistoryReadValueId) -> ua.HistoryReadResult:
        encode = self._encoders.get(node.NodeId)
        if encode is None or not isinstance(details, ua.ReadRawModifiedDetails) or details.IsReadModified:
            return _make_failure(ua.StatusCodes.BadHistoryOperationUnsupported)
        try:
            request = _parse(details, node.ContinuationPoint)
        except struct.error:
            return _make_failure(ua.StatusCodes.BadContinuationPointInvalid)
        if request is None:
            return _make_failure(ua.StatusCodes.BadInvalidTimestampArgument)
        read = self._read_backwards if request.backwards else self._read_forwards
        records = await asyncio.to_thread(read, request)
        shown, more = records[: request.count], len(records) > request.count
        result, data = ua.HistoryReadResult(), ua.HistoryData()
        data.DataValues = [encode(record) for record in shown]
        result.HistoryData = data
        status = ua.StatusCodes.Good if shown else ua.StatusCodes.GoodNoData
        result.StatusCode = ua.StatusCode(status)
        if more and _has_next_page(details):
            last = shown[-1]
            direction = int(request.backwards)
            result.ContinuationPoint = _MARK.pack(_MAGIC, direction, last.wall_ns, last.number)
        return result

    def _read_forwards(self, request: _Request) -> list[BeltRecord]:
        """Return one record more than the page holds, where there is one."""
        after, found = request.last[1] if request.last else 0, list[BeltRecord]()
        while len(found) <= request.count:
            limit = min(_READ, request.count + 1 - len(found))
            page = self._plant.read_period(request.since_ns, request.until_ns, limit, after)
            found += page
            if len(page) < limit:
                break
            after = page[-1].number
        return found

    def _read_backwards(self, request: _Request) -> list[BeltRecord]:
        """Return one record more than the page holds, the newest first."""
        found = list[BeltRecord]()
        for since_ns, until_ns in self._list_windows(request):
            missing = request.count + 1 - len(found)
            if missing <= 0:
                break
            found += self._read_window(since_ns, until_ns, request.last, missing)
        return found

    def _list_windows(self, request: _Request) -> Iterator[tuple[int, int]]:
        """Yield stretches of time that together are the period, from the last to the first, each longer."""
        until_ns = request.until_ns if request.last is None else min(request.until_ns, request.last[0] + 1)
        newest = self._plant.read_records(self._plant.read_last_number() - 1, 1)
        if newest and request.since_ns <= newest[0].wall_ns < until_ns - 1:
            yield newest[0].wall_ns + 1, until_ns  # empty, unless the clock was set back
            until_ns = newest[0].wall_ns + 1
        width_ns = _FIRST_WINDOW_NS
        while until_ns > request.since_ns:
            since_ns = max(until_ns - width_ns, request.since_ns)
            yield since_ns, until_ns
            until_ns, width_ns = since_ns, width_ns * 8

    def _read_window(
        self, since_ns: int, until_ns: int, last: tuple[int, int] | None, count: int
    ) -> list[BeltRecord]:
        """Return the newest records of a window that come before the last one that was given."""
        after, best = 0, list[BeltRecord]()
        while page := self._plant.read_period(since_ns, until_ns, _READ, after):
            after = page[-1].number
            open_ones = [record for record in page if last is None or _find_place(record) < last]
            best = heapq.nlargest(count, [*best, *open_ones], key=_find_place)
            if len(page) < _READ:
                break
        return best


def _parse(details: ua.ReadRawModifiedDetails, point: bytes | None) -> _Request | None:
    """Return what is read; None where neither times nor number are given; struct.error for a damaged point.

    A missing end is the newest record; without a beginning it is read backwards.
    """
    start_ns, end_ns, number = _to_ns(details.StartTime), _to_ns(details.EndTime), details.NumValuesPerNode
    if start_ns is None and end_ns is None and number == 0:
        return None
    backwards = start_ns is None or (end_ns is not None and start_ns > end_ns)
    first_ns, last_ns = (end_ns, start_ns) if start_ns is not None and backwards else (start_ns, end_ns)
    since_ns = 0 if first_ns is None else first_ns
    until_ns = _END_OF_TIME_NS if last_ns is None else last_ns
    if start_ns is not None and backwards:
        since_ns, until_ns = since_ns + 1000, until_ns + 1000  # the start is included, the end is not
    if start_ns is not None and start_ns == end_ns:
        until_ns += 1000
    last = None
    if point:
        magic, direction, wall_ns, record = _MARK.unpack(point)
        if magic != _MAGIC or bool(direction) != backwards:
            raise struct.error("another request's continuation point")
        last = wall_ns, record
    return _Request(since_ns, until_ns, backwards, last, min(number or _PAGE, _MOST))


def _has_next_page(details: ua.ReadRawModifiedDetails) -> bool:
    """Return whether further values follow on a page: not where the number limits a read without an end."""
    has_both = _to_ns(details.StartTime) is not None and _to_ns(details.EndTime) is not None
    return has_both or details.NumValuesPerNode == 0 or details.NumValuesPerNode > _MOST


def _to_ns(time: datetime | None) -> int | None:
    """Return a time in ns since 1970; None where it is not given."""
    if time is None:
        return None
    known = time if time.tzinfo else time.replace(tzinfo=UTC)
    return None if known < _OLDEST else (known - _EPOCH) // _MICROSECOND * 1000


def _find_place(record: BeltRecord) -> tuple[int, int]:
    return record.wall_ns, record.number


def _make_encoder(quantity: OpcUaQuantity) -> Encode:
    def encode(record: BeltRecord) -> ua.DataValue:
        value = math.nan if quantity.record is None else quantity.record(record)
        return make_value(value, quantity.find_record_status(record, value), record.wall_ns)

    return encode


def _make_record_encoder(quantity: RecordQuantity) -> Encode:
    def encode(record: BeltRecord) -> ua.DataValue:
        value = quantity.read(record)
        if quantity.is_count:
            return make_count(int(value), record.wall_ns)
        return make_value(value, quantity.find_status(record, value), record.wall_ns)

    return encode


def _make_failure(status: int) -> ua.HistoryReadResult:
    result = ua.HistoryReadResult()
    result.StatusCode = ua.StatusCode(status)
    return result
