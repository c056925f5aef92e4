"""Production in the history: sums with the records, batches, product changes, readings, damage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path

import pytest

from beltscape.core.errors import OutputError
from beltscape.core.ledger import BeltRecord
from beltscape.production.scale import ScaleReading
from beltscape.production.sums import ProductionSums, sum_record
from beltscape.sinks.historian import Historian
from beltscape.sinks.historian.recovery import DATABASE
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import START_NS, ledger, same

END_NS = 1 << 62


def tag(records: Sequence[BeltRecord], product: str, batch: int) -> list[BeltRecord]:
    """The records of a product and a batch, with the common part of their σ."""
    return [
        replace(
            record,
            product=product,
            batch=batch,
            strip=record.strip
            and replace(record.strip, common_sigma_mm3=0.6 * record.sigma_mm3, density_sigma_kg_m3=40.0),
        )
        for record in records
    ]


def add_up(records: Sequence[BeltRecord]) -> ProductionSums:
    return reduce(ProductionSums.__add__, map(sum_record, records), ProductionSums())


def assert_same(found: ProductionSums, expected: ProductionSums) -> None:
    for name in ProductionSums.__dataclass_fields__:
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-9), name


def test_batches_add_up_and_survive_a_restart(tmp_path: Path) -> None:
    records = ledger(600)
    history = Historian(tmp_path, HistorySettings())
    number = history.production.start_batch("truck 1", "anna", START_NS)
    history.write(tag(records[:200], "ore", number))
    history.close()
    history = Historian(tmp_path, HistorySettings())
    batch = history.production.open_batch
    assert batch is not None
    assert (batch.number, batch.name, batch.started_by) == (number, "truck 1", "anna")
    history.write([*tag(records[200:300], "coal", number), *tag(records[300:], "coal", 0)])
    history.production.end_batch("anna", START_NS)
    (batch,) = history.production.batches(0, END_NS)
    assert batch.is_complete
    assert_same(dict(batch.by_product)["ore"], add_up(tag(records[:200], "ore", number)))
    assert_same(batch.sums, add_up(tag(records[:300], "", number)))
    history.close()


def test_records_keep_product_and_batch_also_in_day_files(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    day_ns = 86_400 * 10**9
    history = Historian(tmp_path, HistorySettings(database_days=1))
    stored = [
        *tag(ledger(20), "ore", 3),
        *tag(ledger(20, 21, start_ns=START_NS + 3 * day_ns), "coal", 0),
    ]
    history.write(stored)
    history.maintain(START_NS + 4 * day_ns)
    found = history.records(0, END_NS)
    assert list((tmp_path / "days").glob("*.parquet"))
    assert [(r.product, r.batch) for r in found] == [(r.product, r.batch) for r in stored]
    assert all(same(one, other, sections=False) for one, other in zip(found, stored, strict=True))
    history.close()


def test_a_period_adds_up_by_product(tmp_path: Path) -> None:
    records = ledger(900)  # three minutes
    history = Historian(tmp_path, HistorySettings())
    history.write([*tag(records[:400], "ore", 0), *tag(records[400:], "coal", 0)])
    minute = 60 * 10**9
    begin = -(-START_NS // minute) * minute
    inside = [r for r in tag(records[:400], "ore", 0) if begin <= r.wall_ns < begin + minute]
    assert_same(history.production.product_sums(begin, begin + minute)["ore"], add_up(inside))
    whole = history.production.product_sums(0, END_NS)
    assert sorted(whole) == ["coal", "ore"]
    assert sum(each.records for each in whole.values()) == 900
    history.close()


def test_a_second_open_batch_is_refused_and_numbers_grow(tmp_path: Path) -> None:
    history = Historian(tmp_path, HistorySettings())
    first = history.production.start_batch("a", "anna", START_NS)
    with pytest.raises(OutputError):
        history.production.start_batch("b", "anna", START_NS)
    history.production.end_batch("anna", START_NS)
    assert history.production.start_batch("b", "anna", START_NS) > first
    history.close()


def test_the_batch_is_complete_once_another_record_follows(tmp_path: Path) -> None:
    records = ledger(12)
    history = Historian(tmp_path, HistorySettings())
    number = history.production.start_batch("a", "anna", START_NS)
    history.write(tag(records[:6], "", number))
    history.production.end_batch("anna", START_NS)
    assert not history.production.batches(0, END_NS)[0].is_complete
    history.write(records[6:])
    assert history.production.batches(0, END_NS)[0].is_complete
    history.close()


def test_batches_survive_damage_of_the_ledger(tmp_path: Path) -> None:
    history = Historian(tmp_path, HistorySettings())
    history.production.change_product("ore", "anna", START_NS)
    number = history.production.start_batch("ship", "anna", START_NS)
    history.write(tag(ledger(50), "ore", number))
    history.close()
    import sqlite3

    with sqlite3.connect(tmp_path / DATABASE) as connection:
        connection.execute("UPDATE ledger SET state = 'damaged'")
    connection.close()
    history = Historian(tmp_path, HistorySettings())
    assert "damaged" in history.repair_message
    batch, change = history.production.open_batch, history.production.last_change
    assert batch is not None
    assert change is not None
    assert (batch.number, batch.name, change.product) == (number, "ship", "ore")
    history.close()


def test_readings_are_found_with_their_neighbours(tmp_path: Path) -> None:
    history = Historian(tmp_path, HistorySettings())
    history.production.add_readings(
        [ScaleReading(second * 10**9, second * 5.0, "csv") for second in (1, 5, 9, 13)]
    )
    history.production.add_readings([ScaleReading(5 * 10**9, 26.0, "page", "anna")])
    found = history.production.readings(6 * 10**9, 8 * 10**9)
    assert [(r.wall_ns // 10**9, r.kg) for r in found] == [(5, 26.0), (9, 45.0)]
    assert history.production.last_reading == ScaleReading(13 * 10**9, 65.0, "csv")
    history.close()
