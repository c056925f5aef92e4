"""OPC UA: the history of records, page by page, forwards and backwards."""

from __future__ import annotations

import asyncio
import random
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from beltscape.core.ledger import STANDINGS, BeltRecord

pytest.importorskip("asyncua", reason="asyncua is not installed; pip install 'beltscape[opcua]' brings it")

from asyncua import ua

from beltscape.protocols.opcua import history
from beltscape.protocols.opcua.history import RecordHistory
from tests.protocols.plant import FakePlant, make_record
from tests.thorough import list_cases

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
NONE = ua.get_win_epoch()
CODES = ua.StatusCodes


class Ledger(FakePlant):
    """A plant with given records."""

    def __init__(self, records: list[BeltRecord]) -> None:
        super().__init__()
        self._records = records


def at(wall_ns: int) -> datetime:
    return EPOCH + timedelta(microseconds=wall_ns // 1000)


def read_page(
    served: RecordHistory, node: str, start: datetime, end: datetime, number: int, point: bytes | None
):
    details = ua.ReadRawModifiedDetails(IsReadModified=False)
    details.StartTime, details.EndTime, details.NumValuesPerNode = start, end, number
    value = ua.HistoryReadValueId()
    value.NodeId, value.ContinuationPoint = ua.NodeId(node, 2), point
    parameters = ua.HistoryReadParameters(ReleaseContinuationPoints=False)
    parameters.HistoryReadDetails, parameters.NodesToRead = details, [value]
    (result,) = asyncio.run(served.read_history(parameters))
    return result


def read_all(served: RecordHistory, start: datetime, end: datetime, number: int = 0) -> list[int]:
    numbers, point = list[int](), None
    while True:
        result = read_page(served, "Belt.Records.Number", start, end, number, point)
        assert result.StatusCode.is_good()
        numbers += [value.Value.Value for value in result.HistoryData.DataValues]
        point = result.ContinuationPoint
        if point is None:
            return numbers


def make_ledger(rng: random.Random, count: int) -> list[BeltRecord]:
    """Return records, several at the same instant, with a clock that is set back now and then."""
    wall_ns, records = 10**18, list[BeltRecord]()
    for number in range(1, count + 1):
        if rng.random() < 0.02:
            wall_ns -= rng.randint(0, 10**12)
        elif rng.random() < 0.6:
            wall_ns += rng.randint(0, 10**11) // 1000 * 1000
        records.append(replace(make_record(number, rng.choice(STANDINGS)), wall_ns=wall_ns))
    return records


@pytest.mark.parametrize("seed", list_cases(range(4), [3]))
def test_no_record_is_lost_or_repeated_over_pages(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = random.Random(seed)
    monkeypatch.setattr(history, "_PAGE", rng.randint(1, 40))
    monkeypatch.setattr(history, "_READ", rng.randint(1, 30))
    records = make_ledger(rng, 300)
    served = RecordHistory(Ledger(records))
    for _ in range(12):
        since, until = sorted(rng.choice(records).wall_ns for _ in range(2))
        inside = [r for r in records if since <= r.wall_ns < max(until, since + 1)]
        assert read_all(served, at(since), at(until)) == [r.number for r in inside]
        inside = [r for r in records if since < r.wall_ns <= until]
        newest_first = sorted(inside, key=lambda r: (r.wall_ns, r.number), reverse=True)
        if since < until:
            number = rng.choice((0, rng.randint(1, 50)))
            assert read_all(served, at(until), at(since), number) == [r.number for r in newest_first]


def test_a_missing_time_means_the_newest_or_the_oldest() -> None:
    records = [replace(make_record(n), wall_ns=10**18 + n * 10**9) for n in range(1, 101)]
    served = RecordHistory(Ledger(records))
    assert read_all(served, NONE, NONE, 3) == [100, 99, 98]
    assert read_all(served, NONE, at(10**18 + 50 * 10**9), 3) == [49, 48, 47]
    assert read_all(served, at(10**18 + 50 * 10**9), NONE, 3) == [50, 51, 52]
    assert read_all(served, at(10**18 + 98 * 10**9), NONE) == [98, 99, 100]
    failed = read_page(served, "Belt.Records.Number", NONE, NONE, 0, None)
    assert failed.StatusCode.value == CODES.BadInvalidTimestampArgument


def test_values_bear_the_records_status_and_time() -> None:
    records = [
        replace(make_record(n, standing), wall_ns=10**18 + n * 10**9)
        for n, standing in enumerate(STANDINGS, 1)
    ]
    served = RecordHistory(Ledger(records))
    result = read_page(served, "Belt.Monitoring.Process.MassFlowRate", NONE, NONE, 9, None)
    values = result.HistoryData.DataValues[::-1]
    assert [value.StatusCode.value for value in values] == [
        CODES.Good, CODES.UncertainSensorNotAccurate, CODES.BadSensorFailure,
    ]  # fmt: skip
    strip = records[0].strip
    assert strip is not None
    assert values[0].Value.Value == strip.mass_flow_t_h
    assert values[0].SourceTimestamp == at(records[0].wall_ns)


def test_damaged_points_and_other_operations_are_refused() -> None:
    served, rng = RecordHistory(Ledger([make_record(1)])), random.Random(5)
    number, now = "Belt.Records.Number", at(10**18 + 10**12)
    for _ in range(50):
        point = rng.randbytes(rng.randint(1, 40))
        result = read_page(served, number, EPOCH, now, 0, point)
        assert result.StatusCode.value == CODES.BadContinuationPointInvalid
    for node in ("Belt.Totals.Volume", "Nothing"):
        result = read_page(served, node, EPOCH, now, 0, None)
        assert result.StatusCode.value == CODES.BadHistoryOperationUnsupported
    update = ua.HistoryUpdateParameters()
    update.HistoryUpdateDetails = [ua.ExtensionObject()]
    (refused,) = served.update_history(update)
    assert refused.StatusCode.is_bad()
