"""A load that is even along the belt shows no motion: noise and standing errors must not stand in for it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from beltscape.core.findings import Finding
from beltscape.core.ledger import FlowRecord
from beltscape.measure.flow.meter import BeltFlowMeter, FramePlacement
from beltscape.measure.flow.registration import HighPassHeights, compute_high_pass, register
from beltscape.measure.flow.settings import FlowSettings
from tests.measure.flow.moving_belt import (
    COARSE_CAMERA,
    Heap,
    add_standing_errors,
    depth_map,
    make_empty_belt,
)
from tests.thorough import list_cases

RIDGE = Heap(start_mm=-20_000, end_mm=20_000, hills_mm=0.0)
OVERLAP = 0.12


def seen(heap: Heap, place_mm: float, *, noise_mm: float = 0.2, seed: int = 0) -> HighPassHeights:
    reference = make_empty_belt(COARSE_CAMERA)
    depth = depth_map(heap, place_mm, seed=seed, noise_mm=noise_mm, camera=COARSE_CAMERA)
    return compute_high_pass(reference.coarse(depth, 2), 2 * reference.cell_mm, reference.belt.noise_mm)


def measure(
    places: Sequence[float], encoder: Sequence[float] | None, *, heap: Heap = RIDGE, standing_mm: float = 0.0
) -> tuple[BeltFlowMeter, list[FlowRecord], list[FramePlacement], list[Finding]]:
    steps: list[FramePlacement] = []
    findings: list[Finding] = []
    meter = BeltFlowMeter(
        make_empty_belt(COARSE_CAMERA), FlowSettings(direction="+y"), watch_step=steps.append
    )
    records: list[FlowRecord] = []
    for k, place in enumerate(places):
        depth = depth_map(heap, place, seed=k, camera=COARSE_CAMERA)
        depth = add_standing_errors(depth, standing_mm) if standing_mm else depth
        records += meter.push(
            depth, round(k * 1e8), None if encoder is None else encoder[k], frame=f"{k:03d}"
        )
        findings += [one for one in meter.findings if one.check == "encoder_motion"]
    return meter, records + meter.finish(), steps, findings


@pytest.mark.parametrize("noise_mm", [0.2, 0.5])
@pytest.mark.parametrize("step_mm", [40.0, 100.0, 210.0, 300.0])
def test_noise_of_an_even_load_is_no_motion(step_mm: float, noise_mm: float) -> None:
    for seed in range(6):
        before = seen(RIDGE, 0.0, noise_mm=noise_mm, seed=2 * seed)
        after = seen(RIDGE, step_mm, noise_mm=noise_mm, seed=2 * seed + 1)
        assert register(before, after, least_overlap=OVERLAP, near_mm=step_mm) is None
        assert register(before, after, least_overlap=OVERLAP) is None


@pytest.mark.parametrize("hills_mm", [2.0, 1.0, 0.5])
def test_sigma_holds_up_to_a_nearly_even_load(hills_mm: float) -> None:
    """The lower the hills, the more of the slopes is noise: σ grows, and the error with it."""
    errors: list[float] = []
    for seed in range(12):
        heap = Heap(start_mm=-1500, end_mm=1500, hills_mm=hills_mm, seed=seed)
        step_mm = 60.0 + 20 * seed
        before, after = seen(heap, 0.0), seen(heap, step_mm)
        shift = register(before, after, least_overlap=OVERLAP, near_mm=step_mm)
        assert shift is not None
        errors.append((shift.along_mm - step_mm) / shift.sigma_mm)
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.5


@pytest.mark.parametrize("standing_mm", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("step_mm", list_cases([12.0, 40.0, 100.0, 210.0], [12.0, 210.0]))
def test_a_sound_encoder_counts_the_metres_of_an_even_load(step_mm: float, standing_mm: float) -> None:
    places = list(np.arange(0.0, 1500.0, step_mm))
    meter, records, steps, findings = measure(places, places, standing_mm=standing_mm)
    for step, place in zip(steps, places, strict=True):
        assert step.place.position_mm == pytest.approx(place, abs=0.5)
        assert abs(step.place.position_mm - place) <= 4 * step.place.sigma_mm + 1e-9
    assert not any(one.is_fault for one in findings)
    assert {record.quality for record in records} == {"measured"}
    length_mm = meter.totals.length_mm
    truth_mm3 = length_mm * RIDGE.volume_between_mm3(0.0, 100.0) / 100
    assert abs(meter.totals.volume_mm3 - truth_mm3) < 3 * meter.totals.sigma_mm3 + 0.002 * truth_mm3


@pytest.mark.parametrize("standing_mm", [0.0, 0.3])
def test_without_an_encoder_an_even_load_has_no_motion_and_says_so(standing_mm: float) -> None:
    places = list(100.0 * np.arange(14))
    meter, records, _, _ = measure(places, None, standing_mm=standing_mm)
    # one view of belt is counted, the one with which the counting begins
    assert sorted(record.quality for record in records) == ["measured"] + ["missing"] * (len(places) - 1)
    assert meter.motion.speed is None


@pytest.mark.parametrize("standing_mm", [0.0, 0.3])
def test_an_even_load_behind_a_heap_accuses_no_encoder(standing_mm: float) -> None:
    places = list(100.0 * np.arange(22))
    _, records, steps, findings = measure(places, places, heap=_HEAP_AND_RIDGE, standing_mm=standing_mm)
    assert not any(one.is_fault for one in findings)
    assert {record.quality for record in records} == {"measured"}
    assert {steps[k].place.source for k in range(2, 8)} == {"material"}
    for before, after in pairwise(steps):
        assert after.place.position_mm - before.place.position_mm == pytest.approx(100.0, abs=0.7)


def test_an_even_load_behind_a_heap_goes_on_at_the_last_speed_and_says_so() -> None:
    places = list(100.0 * np.arange(22))
    _, records, steps, _ = measure(places, None, heap=_HEAP_AND_RIDGE)
    last = steps[-1].place
    assert {step.place.source for step in steps[-6:]} == {"speed"}
    assert {record.quality for record in records[-6:]} == {"degraded"}
    assert abs(last.position_mm - places[-1] - (steps[0].place.position_mm - places[0])) < 2 * last.sigma_mm


class _HeapAndRidge(Heap):
    """Hills that end where an even ridge of the same section goes on."""

    def height_mm(self, x, y):
        hilly = np.clip((np.asarray(y) + 900) / 200, 0, 1)
        return hilly * super().height_mm(x, y) + (1 - hilly) * RIDGE.height_mm(x, y)


_HEAP_AND_RIDGE = _HeapAndRidge(start_mm=-20_000, end_mm=20_000)
