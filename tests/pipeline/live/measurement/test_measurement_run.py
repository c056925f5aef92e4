"""Consecutive runs: every millimetre of the encoder is in the ledger exactly once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.ledger import BeltRecord
from beltscape.core.progress import Silent
from beltscape.measure.flow.blocks import BeltPiece
from beltscape.measure.flow.meter import BeltFlowMeter
from beltscape.measure.flow.settings import FlowSettings
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementRun
from beltscape.pipeline.measuring.flow_chain import FlowChain
from tests.synthetic.belt_feed import CAMERAS, HEAP, FakeMatcher, frames, make_context, run
from tests.thorough import examples

STEP_MM = 60.0


def measured(state: LedgerState, sets: Sequence, *, killed: bool = False) -> list[BeltRecord]:
    """Return the ledger entries of a run; a killed run does not finish."""
    measurement = run(state)
    out = [entry for one in sets for entry in measurement.push(one).entries]
    return out if killed else out + measurement.finish().entries


def reopened(entries: Sequence[BeltRecord], run_number: int) -> LedgerState:
    """Return the ledger state that the historian gives at the next start."""
    if not entries:
        return LedgerState(run_number, 0, None)
    last = entries[-1]
    return LedgerState(run_number, last.number + 1, last.belt_mm[1], last.offset_mm)


def check(entries: Sequence[BeltRecord]) -> None:
    assert [entry.number for entry in entries] == list(range(len(entries)))
    for before, after in pairwise(entries):
        assert after.belt_mm[0] == before.belt_mm[1]
    for entry in entries:
        assert entry.length_mm >= 0
        assert (entry.reason == "") == (entry.standing == "valid")


def positions(start: float, stop: float, step: float = STEP_MM) -> list[float]:
    return [float(place) for place in np.arange(start, stop, step)]


def test_run_counts_the_encoders_travel_and_the_heap() -> None:
    track = positions(0, 3300)
    entries = measured(LedgerState(1, 0, None), [frames(p, 5000 + p) for p in track])
    check(entries)
    assert len(entries) == len(track)
    window = entries[0].length_mm
    assert entries[-1].belt_mm[1] - entries[0].belt_mm[0] == pytest.approx(track[-1] + window, abs=0.5)
    assert sum(e.volume_mm3 for e in entries) == pytest.approx(HEAP.volume_mm3, rel=0.01)
    assert {e.standing for e in entries} == {"valid"}
    sections = [e.section for e in entries if e.section is not None]
    assert len(sections) == len(entries)
    loaded = max(entries, key=lambda e: 0 if e.strip is None else e.strip.area_mm2)
    assert loaded.section is not None
    assert loaded.strip is not None
    area = np.trapezoid(loaded.section.height_mm, loaded.section.x_mm)
    assert area == pytest.approx(loaded.strip.area_mm2, rel=0.02)


def test_run_gives_the_records_of_the_command() -> None:
    sets = [frames(p, p, cameras=() if p == 1200 else CAMERAS) for p in positions(600, 1800)]
    context = make_context()
    chain = FlowChain(
        context.matcher, BeltFlowMeter(context.empty_belt, context.flow, density=context.density)
    )
    offline = [r for one in sets for r in chain.push(one, Silent(), whole=bool(one.images)).records]
    offline += chain.finish()
    entries = measured(LedgerState(1, 0, None), sets)
    assert [repr(e.strip) for e in entries] == [repr(r) for r in offline]


def test_the_belt_that_the_operator_sees_is_the_fused_one() -> None:
    """Heights of all frames, holes filled: those that the meter's pieces hold, joined to the section's columns."""
    sets = [frames(p, p) for p in positions(600, 1800)]
    context = make_context()
    pieces: list[BeltPiece] = []
    meter = BeltFlowMeter(context.empty_belt, context.flow, density=context.density, watch_belt=pieces.append)
    chain = FlowChain(context.matcher, meter)
    for one in sets:
        chain.push(one, Silent(), whole=True)
    chain.finish()
    measurement = run(LedgerState(1, 0, None))
    outcomes = [*(measurement.push(one) for one in sets), measurement.finish()]
    shown = [stretch for outcome in outcomes for stretch in outcome.stretches]
    assert len(shown) == len(pieces)
    for stretch, piece in zip(shown, pieces, strict=True):
        side = piece.height_mm.shape[1] // len(stretch.x_mm)
        fused = (
            piece.height_mm[:, : side * len(stretch.x_mm)]
            .reshape(len(piece.height_mm), -1, side)
            .mean(axis=2)
        )
        np.testing.assert_allclose(stretch.height_mm, fused, atol=1e-4)
        assert stretch.start_mm == pytest.approx(piece.first * context.empty_belt.cell_mm)
    assert sum(len(piece.height_mm) for piece in pieces) * context.empty_belt.cell_mm > 1200


def test_frame_without_one_camera_is_degraded_with_the_reason() -> None:
    sets = [frames(p, p, cameras=("cam0",) if 900 <= p < 1100 else CAMERAS) for p in positions(600, 1500)]
    entries = measured(LedgerState(1, 0, None), sets)
    check(entries)
    degraded = [e for e in entries if e.standing == "degraded"]
    assert {e.reason for e in degraded} == {"without cam1"}
    assert len(degraded) == sum(900 <= p < 1100 for p in positions(600, 1500))
    assert all(e.cameras == 1 for e in degraded)


def test_belt_measured_with_inconsistent_cameras_is_degraded() -> None:
    context = make_context()
    matcher = FakeMatcher()
    chain = FlowChain(matcher, BeltFlowMeter(context.empty_belt, context.flow, density=context.density))
    records = []
    for place in positions(0, 1500):
        matcher.is_inconsistent = 600 <= place < 800
        records += chain.push(frames(place, place), Silent(), whole=True).records
    records += chain.finish()
    is_inconsistent = [record.frame for record in records if record.quality == "degraded"]
    assert is_inconsistent == [f"{place}" for place in positions(0, 1500) if 600 <= place < 800]


def test_graceful_stop_loses_nothing() -> None:
    first = measured(LedgerState(1, 0, None), [frames(p, p) for p in positions(0, 1500)])
    state = reopened(first, 2)
    # the belt stood still meanwhile
    second = measured(state, [frames(p, p) for p in positions(1440, 3300)])
    check([*first, *second])
    assert "nothing measured while it passed" not in {e.reason for e in second}
    total = sum(e.volume_mm3 for e in [*first, *second])
    assert total == pytest.approx(HEAP.volume_mm3, rel=0.01)


def test_belt_that_passed_while_nothing_ran_is_missing() -> None:
    first = measured(LedgerState(1, 0, None), [frames(p, p) for p in positions(0, 900)])
    second = measured(reopened(first, 2), [frames(p, p) for p in positions(2400, 3300)])
    check([*first, *second])
    gap = second[0]
    assert (gap.standing, gap.strip, gap.reason) == ("missing", None, "nothing measured while it passed")
    window = first[0].length_mm
    assert gap.length_mm == pytest.approx(2400 - 840 - window, abs=1.0)


@pytest.mark.thorough
def test_killed_run_keeps_finished_records_and_the_rest_is_measured_again() -> None:
    first = measured(LedgerState(1, 0, None), [frames(p, p) for p in positions(0, 1500)], killed=True)
    state = reopened(first, 2)
    second = measured(state, [frames(p, p) for p in positions(1500, 3300)])
    entries = [*first, *second]
    check(entries)
    # what had left the view but was not finished is lost and reported as missing: about two blocks and a frame's step
    (gap,) = (e for e in entries if e.standing == "missing")
    assert 0 < gap.length_mm < 300 + STEP_MM
    lost = HEAP.volume_between_mm3(-gap.belt_mm[1], -gap.belt_mm[0])
    assert sum(e.volume_mm3 for e in entries) + lost == pytest.approx(HEAP.volume_mm3, rel=0.01)


@pytest.mark.thorough
def test_encoder_reset_continues_in_the_ledger() -> None:
    sets = [frames(p, 90_000 + p if p < 1500 else p - 1500) for p in positions(0, 3000)]
    entries = measured(LedgerState(1, 0, None), sets)
    check(entries)
    assert {e.offset_mm for e in entries} != {0.0}
    # the material shows that the belt went on: nothing is counted twice, nothing is lost
    assert entries[-1].belt_mm[1] - entries[0].belt_mm[0] == pytest.approx(
        2940 + entries[0].length_mm, rel=0.002
    )
    assert "missing" not in {e.standing for e in entries}
    assert entries[-1].offset_mm == pytest.approx(91_500, abs=5)


def test_encoder_reset_between_runs_continues_in_the_ledger() -> None:
    first = measured(LedgerState(1, 0, None), [frames(p, 90_000 + p) for p in positions(0, 900)])
    second = measured(reopened(first, 2), [frames(p, p) for p in positions(900, 1500)])
    third = measured(reopened([*first, *second], 3), [frames(p, p) for p in positions(1500, 2100)])
    check([*first, *second, *third])
    assert "nothing measured while it passed" not in {e.reason for e in [*second, *third]}


def test_motion_of_the_material_is_used_without_an_encoder() -> None:
    first = measured(LedgerState(1, 0, None), [frames(p, None) for p in positions(900, 1800)])
    second = measured(reopened(first, 2), [frames(p, None) for p in positions(1800, 2700)])
    check([*first, *second])
    lengths = [sum(e.length_mm for e in part) for part in (first, second)]
    assert lengths[0] == pytest.approx(lengths[1], rel=0.02)
    assert lengths[0] == pytest.approx(840 + first[0].length_mm, rel=0.02)


def test_failure_leaves_a_gap_and_measuring_continues() -> None:
    measurement = run(LedgerState(1, 0, None))
    entries = [entry for p in positions(0, 1200) for entry in measurement.push(frames(p, p)).entries]
    with pytest.raises(ValueError, match="could not convert"):
        measurement.push(replace(frames(1200, 1200), frame="a frame that the matcher cannot read"))
    measurement.reset()
    entries += [entry for p in positions(1260, 2100) for entry in measurement.push(frames(p, p)).entries]
    entries += measurement.finish().entries
    check(entries)
    (gap,) = (e for e in entries if e.standing == "missing")
    assert 0 < gap.length_mm < 300 + STEP_MM


def test_flushing_changes_no_record_and_returns_them_earlier() -> None:
    sets = [frames(p, p) for p in positions(600, 1500)]
    plain, settled = run(LedgerState(1, 0, None)), run(LedgerState(1, 0, None))
    late, early, ahead = [], [], 0
    for number, one in enumerate(sets):
        late += plain.push(one).entries
        early += settled.push(one).entries
        if number % 3:
            early += settled.flush().entries
            ahead = max(ahead, len(early) - len(late))
        assert len(early) >= len(late)
    assert ahead > 0
    late += plain.finish().entries
    early += settled.finish().entries
    assert [repr(e.strip) for e in early] == [repr(e.strip) for e in late]
    check(early)


@pytest.mark.thorough
def test_encoder_that_starts_later_takes_over() -> None:
    sets = [frames(p, None if p < 1500 else 40_000 + p) for p in positions(900, 2700)]
    check(measured(LedgerState(1, 0, None), sets))


@given(
    cuts=st.lists(st.tuples(st.integers(1, 14), st.integers(0, 12), st.booleans()), min_size=1, max_size=4),
    lost=st.sets(st.integers(0, 40), max_size=12),
    blind=st.sets(st.integers(0, 40), max_size=8),
)
@examples(15)
def test_any_stops_kills_and_losses_leave_a_ledger_without_gap_or_overlap(cuts, lost, blind) -> None:
    """Runs of some frames, pauses of some frames during which the belt goes on, frames lost or without images."""
    entries: list[BeltRecord] = []
    frame = 0
    for number, (length, pause, killed) in enumerate(cuts, 1):
        track = [k for k in range(frame, frame + length) if k not in lost]
        sets = [frames(60.0 * k, 60.0 * k, cameras=() if k in blind else CAMERAS) for k in track]
        entries += measured(reopened(entries, number), sets, killed=killed)
        frame += length + pause
    check(entries)
    if entries:
        span = entries[-1].belt_mm[1] - entries[0].belt_mm[0]
        assert span == pytest.approx(sum(e.length_mm for e in entries), abs=1e-6)
        assert entries[-1].belt_mm[1] <= 60.0 * frame + 500.0


@pytest.mark.parametrize("direction", ["+y", pytest.param(None, marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    "state",
    [
        LedgerState(1, 0, None),
        pytest.param(LedgerState(1, 0, 5000.0, 1000.0), marks=pytest.mark.thorough),
        pytest.param(LedgerState(1, 0, 9e6, 1000.0), marks=pytest.mark.thorough),
    ],
    ids=["new", "continued", "the encoder was reset"],
)
def test_belt_of_a_dark_start_is_missing_while_it_passes(state: LedgerState, direction: str | None) -> None:
    context = replace(make_context(), flow=FlowSettings(direction=direction))  # pyrefly: ignore[bad-argument-type]
    measurement = MeasurementRun(context, replace(state), CAMERAS, lambda: 17, Silent())
    reach = max(map(abs, context.empty_belt.window_mm))
    entries: list[BeltRecord] = []
    for place in positions(0, 9000):
        entries += measurement.push(frames(place, 4000 + place, cameras=())).entries
        if place > 1500:  # what has left the view is in the ledger, and nothing else
            passed = entries[-1].belt_mm[1] - entries[0].belt_mm[0]
            assert place - passed < 2 * reach + 10 * STEP_MM
            assert entries[-1].belt_mm[1] <= 4000 + place + entries[-1].offset_mm - reach + 0.01
    check(entries)
    assert {e.standing for e in entries} == {"missing"} and max(
        e.length_mm for e in entries
    ) <= STEP_MM + 0.01
    stopped = measurement.finish().entries  # the program is stopped, and started in the light
    check([*entries, *stopped])
    again = MeasurementRun(context, reopened([*entries, *stopped], 2), CAMERAS, lambda: 17, Silent())
    light = positions(9000, 10200)
    lit = [e for place in light for e in again.push(frames(place, 4000 + place)).entries]
    check(everything := [*entries, *stopped, *lit, *again.finish().entries])
    travelled = light[-1] + 2 * reach if state.end_mm is None else everything[-1].belt_mm[1] - state.end_mm
    assert everything[-1].belt_mm[1] - everything[0].belt_mm[0] == pytest.approx(travelled, abs=10.0)
    missing = sum(e.length_mm for e in everything if e.standing == "missing")
    assert missing == pytest.approx(9000, abs=2 * reach)


@pytest.mark.thorough
def test_a_start_in_the_dark_goes_on_in_the_light_without_a_gap_or_an_overlap() -> None:
    track = [frames(p, 5000 + p, cameras=() if p < 3000 else CAMERAS) for p in positions(0, 6000)]
    entries = measured(LedgerState(1, 0, None), track)
    check(entries)
    dark = [e for e in entries if e.standing == "missing"]
    assert all(e.standing == "valid" for e in entries[len(dark) :])
    assert entries[-1].belt_mm[1] - entries[len(dark)].belt_mm[0] == pytest.approx(
        5940 - 3000 + entries[len(dark)].length_mm, abs=0.5
    )
    # before the first frame that shows it: the travel, less what that frame still shows
    assert sum(e.length_mm for e in dark) == pytest.approx(3000, abs=10.0)
