"""The flow meter on a smooth heap: the total is the same for any frame rate, direction, gap and encoder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.ledger import FlowRecord
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.flow.density import Density
from beltscape.measure.flow.meter import BeltFlowMeter, FramePlacement
from beltscape.measure.flow.settings import FlowSettings
from tests.measure.flow.moving_belt import CAMERA, COARSE_CAMERA, Heap, depth_map, make_empty_belt
from tests.thorough import list_cases

HEAP = Heap(start_mm=-1150, end_mm=-450)
"""Comes in from -y."""
BACK = Heap(start_mm=450, end_mm=1150)
"""Comes in from +y."""
PASSED_MM = 1500.0


@cache
def floor() -> EmptyBeltReference:
    return make_empty_belt(COARSE_CAMERA)


@cache
def seen(heap: Heap, place_mm: float, direction: int) -> DepthMap:
    return depth_map(heap, place_mm, direction, camera=COARSE_CAMERA)


def positions(step_mm: float, start_mm: float = 0.0) -> list[float]:
    return list(np.arange(start_mm, start_mm + PASSED_MM, step_mm))


def measure(
    places: Sequence[float],
    *,
    direction: int = 1,
    encoder: Sequence[float] | bool | None = True,
    settings: FlowSettings | None = None,
    lost: Sequence[int] = (),
    density: Density | None = None,
    camera: Camera = COARSE_CAMERA,
) -> tuple[BeltFlowMeter, list[FlowRecord], list[FramePlacement]]:
    """Push a capture frame by frame; ``encoder`` True: the true places, None: none."""
    steps: list[FramePlacement] = []
    meter = BeltFlowMeter(make_empty_belt(camera), settings, density=density, watch_step=steps.append)
    counts = list(places) if encoder is True else encoder
    heap = HEAP if direction == 1 else BACK
    records: list[FlowRecord] = []
    for k, place in enumerate(places):
        depth = None if k in lost else depth_map(heap, place, direction, camera=camera)
        records += meter.push(depth, round(k * 1e8), counts[k] if counts else None, frame=f"{k:03d}")
    return meter, records + meter.finish(), steps


@cache
def measure_whole() -> tuple[BeltFlowMeter, list[FlowRecord]]:
    """Return what a capture without any fault gives."""
    return measure(positions(100.0))[:2]


def check_every_mm_once(meter: BeltFlowMeter, records: Sequence[FlowRecord]) -> None:
    strips = [r.strip_mm for r in records if np.isfinite(r.strip_mm[0])]
    for before, after in pairwise(strips):
        assert before[1] == after[0]
    assert sum(r.volume_mm3 for r in records) == pytest.approx(meter.totals.volume_mm3, rel=1e-12)
    assert meter.totals.length_mm == pytest.approx(strips[-1][1] - strips[0][0], abs=1e-6)
    assert meter.totals.first_strip_mm == strips[0]


@pytest.mark.parametrize("step_mm", list_cases([60.0, 141.0, 230.0], [141.0, 230.0]))
def test_total_is_the_same_at_any_frame_rate(step_mm: float) -> None:
    meter, records, _ = measure(positions(step_mm))
    check_every_mm_once(meter, records)
    assert len(records) == len(positions(step_mm))
    assert meter.totals.volume_mm3 == pytest.approx(HEAP.volume_mm3, rel=0.004)
    assert abs(meter.totals.volume_mm3 - HEAP.volume_mm3) < 3 * meter.totals.sigma_mm3
    assert {r.quality for r in records} == {"measured"}


def test_cutting_the_run_in_two_loses_and_doubles_nothing() -> None:
    places = positions(100.0)
    whole, _ = measure_whole()
    first, _, _ = measure(places[:8])
    second, _, _ = measure(places[7:])
    # the second run's first strip is all that was in view: of it only what the first run did not count is new
    both = first.totals.volume_mm3 + second.totals.volume_mm3
    seen_twice = measure(places[7:8])[0].totals.volume_mm3
    assert both - seen_twice == pytest.approx(whole.totals.volume_mm3, rel=0.01)


@pytest.mark.parametrize("direction", list_cases([1, -1], [-1]))
def test_motion_and_direction_come_from_the_material_without_an_encoder(direction: int) -> None:
    places = positions(100.0)
    meter, records, steps = measure(places, direction=direction, encoder=None, camera=CAMERA)
    again = measure(places, direction=direction, encoder=None, camera=CAMERA)[1]
    assert [repr(record) for record in again] == [repr(record) for record in records]
    heap = HEAP if direction == 1 else BACK
    assert meter.direction == direction
    assert meter.totals.volume_mm3 == pytest.approx(heap.volume_mm3, rel=0.006)
    assert sum(s.place.source == "material" for s in steps) >= 6
    for one, two in pairwise(steps):
        if one.place.source == two.place.source == "material":
            error = two.place.position_mm - one.place.position_mm - 100.0
            assert abs(error) < 0.2
            assert abs(error) < 4 * two.place.sigma_mm
    # where the belt is empty nothing tells the motion: the last speed goes on, and is said to
    blind = {s.frame for s in steps if s.place.source == "speed"}
    assert {r.quality for r in records if r.frame in blind} <= {"degraded"}
    check_every_mm_once(meter, records)


@pytest.mark.parametrize("scale", list_cases([0.97, 1.02], [0.97]))
def test_a_wrong_encoder_scale_is_found_and_does_no_harm(scale: float) -> None:
    places = positions(100.0)
    meter, records, _ = measure(places, encoder=[scale * place for place in places])
    assert abs(meter.scale.ratio - scale) < min(0.002, 4 * meter.scale.sigma)
    assert meter.totals.volume_mm3 == pytest.approx(HEAP.volume_mm3, rel=0.006)
    assert records[3].belt_position_mm == pytest.approx(scale * places[3])


def test_a_slipping_belt_is_measured_by_its_material() -> None:
    places = positions(100.0)
    slipping = np.cumsum([0.0, *np.where(np.arange(len(places) - 1) % 2, 110.0, 100.0)])
    meter, _, _ = measure(places, encoder=list(slipping))
    assert meter.scale.ratio == pytest.approx(1.05, abs=0.02)
    assert meter.scale.scatter_mm > 2
    assert meter.totals.volume_mm3 == pytest.approx(HEAP.volume_mm3, rel=0.006)


def test_a_lost_frame_is_seen_by_its_neighbours() -> None:
    meter, records, _ = measure(positions(100.0), lost=(7,))
    assert meter.totals.volume_mm3 == pytest.approx(HEAP.volume_mm3, rel=0.004)
    assert meter.totals.bridged_mm == 0
    assert records[7].quality == "measured"
    check_every_mm_once(meter, records)


def test_a_gap_longer_than_the_view_is_bridged_with_its_own_sigma() -> None:
    whole, _ = measure_whole()
    meter, records, _ = measure(positions(100.0), lost=tuple(range(5, 12)))
    assert meter.totals.bridged_mm > 100
    assert "bridged" in {r.quality for r in records}
    assert meter.totals.sigma_mm3 > 3 * whole.totals.sigma_mm3
    assert abs(meter.totals.volume_mm3 - HEAP.volume_mm3) < 2.5 * meter.totals.sigma_mm3
    check_every_mm_once(meter, records)


def test_a_gap_too_long_to_bridge_is_not_counted() -> None:
    meter, records, _ = measure(
        positions(100.0), lost=tuple(range(5, 12)), settings=FlowSettings(bridge_mm=60.0)
    )
    assert meter.totals.bridged_mm == 0
    assert meter.totals.unseen_mm > 100
    assert "missing" in {r.quality for r in records}
    assert meter.totals.volume_mm3 < 0.95 * HEAP.volume_mm3


@pytest.mark.parametrize("encoder", list_cases([True, None], [None]))
def test_a_stop_adds_nothing(encoder: bool | None) -> None:
    places = [*positions(100.0)[:9], *[800.0] * 5, *positions(100.0)[9:]]
    meter, records, _ = measure(places, encoder=encoder)
    assert meter.totals.volume_mm3 == pytest.approx(HEAP.volume_mm3, rel=0.006)
    still = records[9:14]
    assert abs(sum(r.volume_mm3 for r in still)) < 0.001 * HEAP.volume_mm3
    assert max(abs(r.volume_flow_m3_h) for r in still) < 0.02 * records[6].volume_flow_m3_h
    check_every_mm_once(meter, records)


def test_a_belt_that_rolls_back_a_bit_counts_nothing_twice() -> None:
    places = [*positions(100.0)[:10], 860.0, 880.0, *positions(100.0)[10:]]
    meter, records, _ = measure(places, encoder=None)
    assert meter.totals.volume_mm3 == pytest.approx(HEAP.volume_mm3, rel=0.006)
    check_every_mm_once(meter, records)


def test_records_come_as_soon_as_their_belt_has_left_and_memory_stays_bounded() -> None:
    meter = BeltFlowMeter(floor(), FlowSettings(direction="+y"))
    held: list[int] = []
    given = 0
    for k in range(36):
        given += len(meter.push(depth_map(None, 0.0, camera=COARSE_CAMERA), k * 10**8, 20.0 * k))
        held.append(len(meter._buffer._layers))
    late = (floor().seen_mm[1] - floor().seen_mm[0] + 80 + 50 + 40) / 20.0
    assert given >= 36 - late
    assert max(held) <= meter.settings.layers + 2


def test_an_empty_belt_without_an_encoder_is_never_given_a_speed() -> None:
    meter = BeltFlowMeter(floor())
    records: list[FlowRecord] = []
    for k in range(14):
        records += meter.push(depth_map(None, 50.0 * k, camera=COARSE_CAMERA), k * 10**8, frame=str(k))
    records += meter.finish()
    assert len(records) == 14
    assert sum(r.quality == "missing" for r in records) == 13
    assert meter.totals.volume_mm3 == pytest.approx(0, abs=0.003 * HEAP.volume_mm3)


def test_mass_follows_density_over_time() -> None:
    table = Density(np.array([0, 700_000_000]), np.array([800.0, 1600.0]), np.array([8.0, 16.0]))
    meter, records, _ = measure(positions(100.0), density=table)
    early = sum(r.volume_mm3 for r in records if (r.time_ns or 0) < 700_000_000)
    late = sum(r.volume_mm3 for r in records) - early
    assert meter.totals.mass_kg == pytest.approx((800 * early + 1600 * late) * 1e-9, rel=1e-9)
    assert meter.totals.mass_sigma_kg >= 0.01 * meter.totals.mass_kg
    assert records[8].mass_flow_t_h == pytest.approx(1.6 * records[8].volume_flow_m3_h)


def sigma_of_total(systematic_mm: float, step_mm: float) -> tuple[float, float]:
    """σ and length of belt of a total whose depth maps all share an error of this σ."""
    meter = BeltFlowMeter(floor())
    for k, place in enumerate(positions(step_mm)):
        depth = replace(seen(HEAP, place, 1), systematic_mm=systematic_mm)
        meter.push(depth, round(k * 1e8), place)
    meter.finish()
    return meter.totals.sigma_mm3, meter.totals.length_mm


@pytest.mark.parametrize("step_mm", list_cases([60.0, 230.0], [230.0]))
def test_an_error_common_to_all_frames_does_not_average_out(step_mm: float) -> None:
    systematic_mm = 1.5
    sound, length = sigma_of_total(0.0, step_mm)
    doubted, _ = sigma_of_total(systematic_mm, step_mm)
    low, high = floor().belt.across_mm
    added = np.sqrt(doubted**2 - sound**2)
    assert added == pytest.approx(systematic_mm * (high - low) * length, rel=1e-6)


@pytest.mark.parametrize(
    ("standing", "back_mm", "direction"),
    [
        pytest.param(9, -100.0, 1, marks=pytest.mark.thorough),
        (0, -50.0, -1),
        pytest.param(5, -50.0, 1, marks=pytest.mark.thorough),
        pytest.param(5, -50.0, -1, marks=pytest.mark.thorough),
        pytest.param(9, -100.0, -1, marks=pytest.mark.thorough),
        pytest.param(9, -20.0, 1, marks=pytest.mark.thorough),
        pytest.param(9, -20.0, -1, marks=pytest.mark.thorough),
        pytest.param(0, -50.0, 1, marks=pytest.mark.thorough),
    ],
)
def test_a_belt_that_rolls_back_before_it_starts(direction: int, standing: int, back_mm: float) -> None:
    """Loaded from the first frame on; the encoder falls with the material by 400 mm."""
    steps = [0.0] * standing + [back_mm] * round(-400 / back_mm) + [100.0] * 19
    places = list(np.cumsum([700.0, *steps]))
    meter, records, _ = measure(places, direction=direction)
    heap = HEAP if direction == 1 else BACK
    assert meter.direction == direction
    assert meter.totals.volume_mm3 == pytest.approx(heap.volume_mm3, rel=0.004)
    assert {record.quality for record in records} == {"measured"}
    assert meter.totals.length_mm == pytest.approx(1997, rel=0.01)


@pytest.mark.parametrize("step_mm", list_cases([50.0, 100.0], [100.0]))
def test_an_encoder_that_counts_in_reverse_over_a_load_is_no_roll_back(step_mm: float) -> None:
    places = list(700 + step_mm * np.arange(round(1500 / step_mm)))
    meter, records, _ = measure(places, encoder=[-place for place in places])
    assert meter.direction == 1
    assert not any(record.quality == "measured" for record in records)
    assert any("channels A and B" in record.reason for record in records)
    assert meter.totals.volume_mm3 == pytest.approx(HEAP.volume_mm3, rel=0.01)


def test_steps_that_hardly_overlap_are_not_valid_and_named() -> None:
    low, high = floor().seen_mm
    meter = BeltFlowMeter(floor(), FlowSettings(direction="+y"))
    records: list[FlowRecord] = []
    named: list[int] = []
    for k in range(6):
        place = 0.93 * (high - low) * k
        records += meter.push(seen(HEAP, place, 1), round(k * 1e8), place)
        named += [k for one in meter.findings if one.check == "thin_overlap"]
    records += meter.finish()
    assert named == [2, 3, 4, 5]
    assert "measured" not in {record.quality for record in records}


@pytest.mark.parametrize("sudden", list_cases([1, 2, 6], [2]))
def test_a_sudden_speed_on_a_bare_belt_is_not_valid_until_it_returns(sudden: int) -> None:
    """Material, which could confirm it, does not come."""
    meter = BeltFlowMeter(floor(), FlowSettings(direction="+y"))
    records: list[FlowRecord] = []
    for k in range(12):
        ahead = 100.0 * min(max(k - 5, 0), sudden)
        records += meter.push(depth_map(None, 0.0, camera=COARSE_CAMERA), k * 10**8, 100.0 * k + ahead)
    records += meter.finish()
    after = ["measured"] * (6 - sudden)
    assert [record.quality for record in records] == ["measured"] * 6 + ["degraded"] * sudden + after


def test_readings_that_no_belt_can_follow_do_not_enlarge_sigma() -> None:
    places = positions(100.0)
    wrong = [place + (100_000.0 * (k - 7) if k > 7 else 0.0) for k, place in enumerate(places)]
    meter, _, _ = measure(places, encoder=wrong)
    assert meter.totals.volume_mm3 == pytest.approx(HEAP.volume_mm3, rel=0.1)
    assert meter.totals.sigma_mm3 < 0.5 * meter.totals.volume_mm3
