"""Another rig, empty belt or density between two records: no millimetre is lost or counted twice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.events import CertificateReading
from beltscape.core.ledger import BeltRecord
from beltscape.health.settings import BeltLimits
from beltscape.measure.flow.density import Density
from beltscape.pipeline.live.engine_components import MeasuringParts, PeriodicInspector
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementContext
from beltscape.pipeline.live.zero import ZeroControl
from tests.pipeline.live.feed import Feed, engine_of, everything, track
from tests.synthetic.belt_feed import CAMERA, HEAP, RIG, FakeMatcher, frames, make_context, run

STEP_MM = 60.0
CHANGES = (5, 20, 21, 40, 52)
"""Frame sets before which the context changes: before, on and behind the heap."""
TRACK = [float(place) for place in np.arange(0, 3300, STEP_MM)]


def make_other() -> MeasurementContext:
    return replace(make_context(), density=Density.constant(800.0))


@cache
def measure(at: tuple[int, ...], encoder_mm: float | None) -> list[BeltRecord]:
    """Return the records of a run that changes its context before the frame sets of these numbers."""
    measurement = run(LedgerState(1, 1, None))
    out: list[BeltRecord] = []
    for number, place in enumerate(TRACK):
        if number in at:
            measurement.set_context(make_other(), 2 + at.index(number))
        position = None if encoder_mm is None else encoder_mm + place
        out += measurement.push(frames(place, position)).entries
    return out + measurement.finish().entries


def check(records: list[BeltRecord]) -> None:
    for before, after in pairwise(records):
        assert (after.number, after.belt_mm[0]) == (before.number + 1, before.belt_mm[1])
        assert after.run >= before.run


def length(records: list[BeltRecord]) -> float:
    return records[-1].belt_mm[1] - records[0].belt_mm[0]


@pytest.mark.parametrize(
    "encoder_mm", [5000.0, pytest.param(None, marks=pytest.mark.thorough)], ids=["encoder", "material alone"]
)
def test_belt_and_volume_stay_the_same(encoder_mm: float | None) -> None:
    records = measure(CHANGES, encoder_mm)
    check(records)
    assert {one.run for one in records} >= {1, 2, 4, 5, 6}  # run 3 is one frame long
    # without an encoder the belt between two contexts is known by its speed
    whole = TRACK[-1] + records[0].length_mm if encoder_mm else length(measure((), None))
    assert length(records) == pytest.approx(whole, abs=0.5 if encoder_mm else 2.0)
    assert sum(one.volume_mm3 for one in records) == pytest.approx(HEAP.volume_mm3, rel=0.01)
    assert "missing" not in {one.standing for one in records}


def test_the_run_and_its_density_change_at_exactly_one_record() -> None:
    records = measure(CHANGES, 5000.0)
    first = {number: next(one for one in records if one.run == number) for number in (2, 4, 5, 6)}
    # belt that is in view at the change is measured by the frames after it, all of it in one record
    frames_of = {number: one.strip.frame for number, one in first.items() if one.strip is not None}
    assert frames_of == {2: f"{TRACK[5]}", 4: f"{TRACK[21]}", 5: f"{TRACK[40]}", 6: f"{TRACK[52]}"}
    for one in records:
        assert one.strip is not None
        assert one.strip.density_kg_m3 == (1500.0 if one.run == 1 else 800.0)
        assert one.strip.coverage > 0.9 or one.strip.volume_mm3 < 1e4
    before = next(one for one in records if one.number == first[5].number - 1)
    assert first[5].run_sigma_mm3 < before.run_sigma_mm3  # σ of a run's own common errors


@pytest.mark.thorough
def test_without_an_encoder_it_waits_for_a_known_motion() -> None:
    first = next(one for one in measure(CHANGES, None) if one.run == 2)
    assert first.strip is not None and float(first.strip.frame) > TRACK[CHANGES[0]]


def test_a_failing_frame_at_the_change_does_not_lose_it() -> None:
    measurement = run(LedgerState(1, 1, None))
    for place in TRACK[:20]:
        measurement.push(frames(place, place))
    measurement.reset()
    other = make_other()
    measurement.set_context(other, 2)
    records = measurement.push(frames(TRACK[20], TRACK[20])).entries + measurement.finish().entries
    assert measurement.context is other
    assert {one.run for one in records} == {2}


class ChangingMatcher(FakeMatcher):
    """Exchanges the engine's parts when it sees a frame."""

    def __init__(self, exchange: Callable[[], None]) -> None:
        self.exchange = exchange

    def reconstruct(self, frame_set, reporter):
        if frame_set.frame == "900.0":
            self.exchange()
        return super().reconstruct(frame_set, reporter)


def test_the_engine_exchanges_all_parts_with_an_event(tmp_path: Path) -> None:
    matcher = ChangingMatcher(lambda: engine.exchange(other))
    engine, _, historian, parts = engine_of(tmp_path, Feed(track(0, 1800)), matcher=matcher)
    context = make_other()
    other = MeasuringParts(
        context,
        RIG,
        {"rig": "new"},
        PeriodicInspector(context.empty_belt.belt, CAMERA, 0.0, 0.0),
        ZeroControl(context.empty_belt, BeltLimits()),
        12_345.0,
        7.0,
    )
    engine.start()
    assert engine.wait(300)
    assert engine.stop() == 0
    records = list(everything(historian))
    check(records)
    first = next(one for one in records if one.run == 2)
    assert first.strip is not None and first.strip.frame == "960.0"
    assert (parts.gauges.full_area_mm2, parts.gauges.stale_s) == (12_345.0, 7.0)
    (event,) = [one for one in historian.events(0, 1 << 62) if one.kind == "settings"]
    assert event.text.endswith(f"from record {first.number} on")
    assert historian.list_runs(1)[0].provenance == {"rig": "new"}
    historian.close()


def test_records_after_a_certificate_belong_to_a_run_that_names_it(tmp_path: Path) -> None:
    readings = [CertificateReading("2026-0001", 300.0)]
    found: list[CertificateReading | None] = [None]

    def issue() -> None:
        found[0] = readings[0]
        engine._follow_certificate()
        engine._follow_certificate()  # nothing has changed since

    matcher = ChangingMatcher(issue)
    engine, _, historian, _ = engine_of(
        tmp_path, Feed(track(0, 1800)), matcher=matcher, read_certificate=lambda _: found[0]
    )
    engine.start()
    assert engine.wait(300)
    assert engine.stop() == 0
    records = list(everything(historian))
    check(records)
    assert {one.run for one in records} == {1, 2}
    first = next(one for one in records if one.run == 2)
    assert first.strip is not None and first.strip.frame == "960.0"
    assert historian.list_runs(1)[0].provenance == {"rig": "own", "certificate": "2026-0001"}
    (event,) = [one for one in historian.events(0, 1 << 62) if one.kind == "certificate"]
    assert event.text == "certificate 2026-0001 of a material test is in force"
    historian.close()
