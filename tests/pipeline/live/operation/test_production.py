"""The present product and batch: changed from the next frame on, kept over a restart, changed by the timetable."""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import pairwise
from math import isnan
from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.core.ledger import BeltRecord, FlowRecord, RecordTag
from beltscape.pipeline.live.event_log import EventLog
from beltscape.pipeline.live.ledger import Ledger, LedgerState
from beltscape.pipeline.live.production import ProductionControl
from beltscape.production.settings import ProductionSettings, ProductSettings, TimetableSettings
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.synthetic.belt_feed import frames, run

PRODUCTS = (
    ProductSettings(name="coal", density_kg_m3=800, sigma_kg_m3=16),
    ProductSettings(name="ore", density_kg_m3=2400, sigma_kg_m3=60),
)


class Clock:
    def __init__(self, *parts: int) -> None:
        self.set(*parts)

    def set(self, *parts: int) -> None:
        self.ns = int(datetime(*parts, tzinfo=UTC).timestamp()) * 10**9

    def __call__(self) -> int:
        return self.ns


@pytest.fixture
def history(tmp_path: Path):
    opened = Historian(tmp_path, HistorySettings())
    yield opened
    opened.close()


def make(
    history: Historian,
    settings: ProductionSettings | None = None,
    products=PRODUCTS,
    clock: Clock | None = None,
) -> ProductionControl:
    class Reporter:
        def warn(self, text: str) -> None:
            raise AssertionError(text)

    events = EventLog(history)
    return ProductionControl(
        products, settings or ProductionSettings(), history.production, events, clock or Clock(2100, 1, 1)
    )


def test_the_first_product_is_chosen_and_a_change_is_kept(history: Historian) -> None:
    control = make(history)
    assert control.tag == RecordTag("coal", 800.0, 16.0, 0)
    assert control.change_product("ore", "anna")
    assert not control.change_product("ore", "anna")
    number = control.start_batch(" truck 7 ", "", "anna")
    again = make(history)
    assert again.tag == control.tag == RecordTag("ore", 2400.0, 60.0, number)
    assert again.batch_name == "truck 7"
    kinds = [(event.kind, event.name, event.by) for event in history.events(0, 1 << 62)]
    assert ("product", "ore", "anna") in kinds
    assert ("batch", "truck 7", "anna") in kinds


def test_what_cannot_be_is_refused_and_changes_nothing(history: Historian) -> None:
    control = make(history)
    before = control.tag
    with pytest.raises(InputError, match="no such product; there are coal, ore"):
        control.change_product("gold", "anna")
    with pytest.raises(InputError, match="no batch is open"):
        control.stop_batch("anna")
    for name in ("", "  ", "a\nb", "x" * 61):
        with pytest.raises(InputError, match="1 to 60 printable"):
            control.start_batch(name, "", "anna")
    with pytest.raises(InputError, match="no such product"):
        control.start_batch("a", "gold", "anna")
    assert control.tag == before
    control.start_batch("a", "ore", "anna")
    with pytest.raises(InputError, match="batch a is open; stop it first"):
        control.start_batch("b", "", "anna")
    control.stop_batch("anna")
    assert control.batch_name == ""
    assert control.tag == RecordTag("ore", 2400.0, 60.0, 0)


def test_a_product_that_the_settings_no_longer_have_gives_way_to_the_first(history: Historian) -> None:
    make(history).change_product("ore", "anna")
    assert make(history, products=PRODUCTS[:1]).tag.product == "coal"
    assert isnan(make(history, products=()).tag.density_kg_m3)


def test_the_timetable_changes_and_a_later_change_by_hand_holds(history: Historian) -> None:
    table = (TimetableSettings(at="06:00", product="ore"), TimetableSettings(at="14:00", product="coal"))
    settings = ProductionSettings(time_zone="Europe/Berlin", timetable=table)
    clock = Clock(2027, 1, 5, 12, 59)  # 13:59 in Berlin
    control = make(history, settings, clock=clock)
    assert control.tag.product == "ore"
    clock.set(2027, 1, 5, 13, 0)
    control.follow_timetable()
    assert control.tag.product == "coal"
    clock.set(2027, 1, 5, 13, 30)
    control.change_product("ore", "anna")
    for hour in (14, 20):
        clock.set(2027, 1, 5, hour)
        control.follow_timetable()
        assert control.tag.product == "ore"
    clock.set(2027, 1, 6, 13, 10)  # the service was off at 06:00 and at 14:00
    assert make(history, settings, clock=clock).tag.product == "coal"


def test_a_change_of_the_timetable_to_the_present_product_counts_as_made(history: Historian) -> None:
    settings = ProductionSettings(timetable=(TimetableSettings(at="06:00", product="coal"),))
    clock = Clock(2027, 1, 5, 5)
    control = make(history, settings, clock=clock)
    clock.set(2027, 1, 5, 6)
    control.follow_timetable()
    control.change_product("ore", "anna")
    clock.set(2027, 1, 5, 7)
    control.follow_timetable()
    assert control.tag.product == "ore"


def test_a_record_carries_what_its_frame_was_counted_for() -> None:
    ledger = Ledger(LedgerState(1, 1, None), ["c"])
    ledger.begin_meter(None)
    tags = [RecordTag("coal", 800.0, 16.0, 0), RecordTag("ore", 2400.0, 60.0, 5)]
    for number, tag in enumerate(tags):
        ledger.push(f"{number}", ["c"], None, tag)
        ledger.set_position(f"{number}", 100.0 * (number + 1))
    strips = [
        FlowRecord(
            f"{k}", k, 0.0, (100.0 * k, 100.0 * k + 100), 1e4, 1e6, 1e4, 1.0, 1.0, 0.9, 0.9, "measured"
        )
        for k in range(2)
    ]
    found = ledger.make_entries(strips, {}, 0)
    assert [(r.product, r.batch) for r in found] == [("coal", 0), ("ore", 5)]
    assert [r.mass_kg for r in found] == [pytest.approx(0.8), pytest.approx(2.4)]
    assert found[1].strip is not None
    assert found[1].strip.density_sigma_kg_m3 == 60.0


def test_a_change_counts_from_the_next_frame_on() -> None:
    measurement, entries = run(LedgerState(1, 1, None)), list[BeltRecord]()
    tags = RecordTag("coal", 800.0, 16.0, 0), RecordTag("ore", 2400.0, 60.0, 7)
    for number in range(20):
        place = 60.0 * number
        entries += measurement.push(frames(place, place), (), tags[number >= 10]).entries
    entries += measurement.finish().entries
    assert [entry.product for entry in entries] == ["coal"] * 10 + ["ore"] * 10
    assert [entry.batch for entry in entries] == [0] * 10 + [7] * 10
    assert all(a.belt_mm[1] == b.belt_mm[0] for a, b in pairwise(entries))
    densities = [entry.strip.density_kg_m3 for entry in entries if entry.strip is not None]
    assert densities == [800.0] * 10 + [2400.0] * 10
    strips = [entry.strip for entry in entries if entry.strip is not None]
    assert all(0 <= strip.common_sigma_mm3 <= strip.sigma_mm3 for strip in strips)
