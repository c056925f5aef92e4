"""Evidence from the material's motion: correct counts, independent of the expected motion."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.measure.flow.meter import BeltFlowMeter
from beltscape.measure.flow.motion_evidence import MotionEvidence
from beltscape.measure.flow.registration import Shift
from beltscape.measure.flow.settings import Direction, FlowSettings
from tests.measure.flow.moving_belt import Heap, depth_map, make_empty_belt
from tests.thorough import THOROUGH, list_cases

STEP_MM = 110.0
HEAP = Heap(start_mm=-900, end_mm=500)


def meter_of(
    way: int, encoder_factor: float | None, direction: Direction | None = None, heap: Heap | None = HEAP
) -> BeltFlowMeter:
    """Push six frames of a belt that moves ``way``; the encoder counts by a factor, None: there is none."""
    meter = BeltFlowMeter(make_empty_belt(), FlowSettings(direction=direction))
    for k in range(6):
        encoder = None if encoder_factor is None else encoder_factor * k * STEP_MM
        meter.push(depth_map(heap, k * STEP_MM, way), round(k * 1e8), encoder)
    return meter


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("encoder", [None, 1.0])
def test_every_frame_pair_shows_the_direction(way: int, encoder: float | None) -> None:
    meter = meter_of(way, encoder)
    evidence = meter.evidence
    assert meter.direction == way
    assert (evidence.along(way), evidence.along(-way)) == (5, 0)
    assert (evidence.agreeing, evidence.conflicting) == (0 if encoder is None else 5, 0)


@pytest.mark.parametrize("factor", list_cases([0.001, 0.1, 0.5, 1.6], [0.001, 1.6]))
def test_an_encoder_of_a_larger_unit_conflicts_in_every_pair(factor: float) -> None:
    evidence = meter_of(1, factor).evidence
    assert evidence.conflicting == 5
    assert evidence.ratios.median == pytest.approx(factor, rel=0.01)
    assert evidence.ratios.spread < 0.02


@pytest.mark.parametrize("factor", [10.0, 1000.0])
def test_encoder_without_common_view_is_still_compared(factor: float) -> None:
    evidence = meter_of(1, factor).evidence
    assert evidence.apart == 5
    assert evidence.apart_ratios.median == pytest.approx(factor, rel=0.01)
    assert evidence.apart_ratios.spread < 0.02


def test_belt_too_fast_for_its_frames_gives_no_conflict() -> None:
    meter = BeltFlowMeter(make_empty_belt(), FlowSettings(direction="+y"))
    heap = Heap(start_mm=-9000, end_mm=500)
    for k in range(9 if THOROUGH else 6):
        meter.push(depth_map(heap, 900.0 * k), round(k * 1e8), 900.0 * k)
    assert meter.evidence.conflicting == 0
    assert meter.evidence.apart < 3 or meter.evidence.apart_ratios.spread > 0.1


@pytest.mark.parametrize("factor", list_cases([0.9, 0.98, 1.1], [0.9]))
def test_a_slipping_encoder_is_no_conflict(factor: float) -> None:
    evidence = meter_of(1, factor).evidence
    assert (evidence.agreeing, evidence.conflicting) == (5, 0)


def test_configured_direction_against_the_material_is_counted() -> None:
    evidence = meter_of(1, 1.0, "-y").evidence
    assert (evidence.plus, evidence.minus, evidence.opposite) == (5, 0, 5)
    assert meter_of(1, None, "-y").evidence.plus == 5


def test_standing_encoder_conflicts() -> None:
    assert meter_of(1, 0.0, "+y").evidence.encoder_still == 5


def test_an_empty_belt_is_no_evidence() -> None:
    meter = meter_of(1, 1.0, "-y", heap=None)
    assert (meter.evidence.moving, meter.evidence.compared) == (0, 0)


def test_assumed_direction_gives_no_evidence() -> None:
    meter = BeltFlowMeter(make_empty_belt(), FlowSettings())
    for k in range(12):
        meter.push(depth_map(None, k * STEP_MM), round(k * 1e8), k * STEP_MM)
    meter.finish()
    assert meter.direction == 0


@given(
    st.lists(
        st.tuples(
            st.floats(-500, 500),
            st.one_of(st.none(), st.floats(-5000, 5000)),
            st.booleans(),
            st.sampled_from([-1, 1]),
        ),
        max_size=30,
    )
)
def test_every_pair_is_counted_once(pairs: list[tuple[float, float | None, bool, int]]) -> None:
    evidence = MotionEvidence()
    for along, encoder, clear, direction in pairs:
        evidence.add(Shift(along, 0.05, 0.0, 0.9, clear), direction, encoder)
    shown = [along for along, _, clear, _ in pairs if clear and abs(along) > 2.2]
    assert evidence.plus == sum(along > 0 for along in shown)
    assert evidence.minus == sum(along < 0 for along in shown)
    both = [
        pair for pair in pairs if pair[2] and pair[1] is not None and max(abs(pair[0]), abs(pair[1])) > 2.2
    ]
    assert evidence.compared == len(both)
