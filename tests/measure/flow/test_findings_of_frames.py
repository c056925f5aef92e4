"""Findings of frames in the flow meter: which strips they degrade or void, and with what σ and reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.findings import Effect, Finding
from beltscape.core.ledger import FlowRecord
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.flow.meter import BeltFlowMeter
from tests.measure.flow.moving_belt import COARSE_CAMERA, Heap, depth_map, make_empty_belt

HEAP = Heap(start_mm=-4000, end_mm=500)
STEP_MM = 100.0
COUNT = 26


@cache
def empty_belt() -> EmptyBeltReference:
    return make_empty_belt(COARSE_CAMERA)


@cache
def seen(place_mm: float) -> DepthMap:
    return depth_map(HEAP, place_mm, camera=COARSE_CAMERA)


def make_finding(
    effect: Effect = "none", text: str = "", *, systematic_mm: float = 0.0, relative_sigma: float = 0.0
) -> Finding:
    return Finding(
        "zero_shift", 1.0, 0.1, 0.5, "mm", text=text, effect=effect,
        systematic_mm=systematic_mm, relative_sigma=relative_sigma,
    )  # fmt: skip


def measure(findings: Mapping[int, Sequence[Finding]]) -> tuple[BeltFlowMeter, list[FlowRecord]]:
    """Push frames with findings; the others have one that passed."""
    meter = BeltFlowMeter(empty_belt())
    records: list[FlowRecord] = []
    for number in range(COUNT):
        place = number * STEP_MM
        made = findings.get(number, [make_finding()])
        records += meter.push(seen(place), number * 10**8, place, frame=str(number), findings=made)
    return meter, records + meter.finish()


@cache
def measure_sound() -> tuple[BeltFlowMeter, list[FlowRecord]]:
    return measure({})


def list_frames(records: Sequence[FlowRecord], quality: str) -> list[int]:
    return [int(record.frame) for record in records if record.quality == quality]


def check_sums(meter: BeltFlowMeter, records: Sequence[FlowRecord]) -> None:
    """Check that the total is the sum of the records that are not missing, which carry nothing."""
    counted = [record for record in records if record.quality != "missing"]
    assert meter.totals.volume_mm3 == pytest.approx(sum(r.volume_mm3 for r in counted), rel=1e-12)
    for record in records:
        if record.quality == "missing":
            assert (record.volume_mm3, record.sigma_mm3) == (0.0, 0.0)
            assert np.isnan(record.area_mm2)


def test_sound_findings_change_nothing() -> None:
    _, records = measure_sound()
    assert list_frames(records, "measured") == list(range(COUNT))
    assert {record.reason for record in records} == {""}


def test_a_degrading_fault_degrades_all_strips_that_its_frame_measures() -> None:
    """A strip that sound frames saw before is fused from faulty ones, too."""
    fault = make_finding("degraded", "the belt has risen", systematic_mm=3.0, relative_sigma=0.1)
    meter, records = measure({number: [fault] for number in range(15, 20)})
    degraded = list_frames(records, "degraded")
    assert set(range(15, 20)) <= set(degraded)
    assert degraded == list(range(degraded[0], 20))
    assert 15 - degraded[0] == pytest.approx(550 / STEP_MM, abs=1)  # the length of the view
    assert {records[number].reason for number in degraded} == {"the belt has risen"}
    low, high = empty_belt().belt.across_mm
    record = records[17]
    heights = 3.0 * (high - low) * (record.strip_mm[1] - record.strip_mm[0])
    assert record.sigma_mm3 >= np.hypot(heights, 0.1 * record.volume_mm3)
    sound, _ = measure_sound()
    assert meter.totals.sigma_mm3 > sound.totals.sigma_mm3 + 5 * 0.99 * heights / np.sqrt(2)
    check_sums(meter, records)


def test_a_fault_applies_back_to_the_last_frame_that_the_check_passed() -> None:
    not_made = Finding("zero_shift", float("nan"), float("nan"), 0.5, "mm")
    fault = make_finding("degraded", "the belt has risen")
    frames: dict[int, list[Finding]] = {number: [not_made] for number in range(12, 15)}
    _, records = measure({**frames, 15: [fault]})
    assert {12, 13, 14, 15} <= set(list_frames(records, "degraded"))
    _, other = measure({15: [fault], **{n: [not_made] for n in range(16, 19)}})
    assert not {16, 17, 18} & set(list_frames(other, "degraded"))


def test_a_momentary_fault_leaves_the_frames_before_it_alone() -> None:
    """Until a check was made once, nothing passed it: copies of the first frame do not void the first frame."""
    copy = Finding("frozen_image", 0.0, 0.05, 0.15, "", "cam1", "it repeats", "degraded", is_momentary=True)
    frames: dict[int, list[Finding]] = {0: [], **{number: [copy] for number in range(8, 11)}}
    frames |= {number: [] for number in range(1, 8)}
    _, records = measure(frames)
    degraded = list_frames(records, "degraded")
    assert {8, 9, 10} <= set(degraded) and 0 not in degraded and 1 not in degraded


def test_a_missing_frame_between_sound_ones_costs_nothing() -> None:
    meter, records = measure({15: [make_finding("missing", "no pattern")]})
    sound, _ = measure_sound()
    assert list_frames(records, "missing") == []
    assert meter.totals.volume_mm3 == pytest.approx(sound.totals.volume_mm3, rel=0.003)


def test_belt_that_only_missing_frames_saw_is_in_no_total() -> None:
    fault = make_finding("missing", "no pattern: check the projector")
    meter, records = measure({number: [fault] for number in range(10, 22)})
    missing = list_frames(records, "missing")
    assert len(missing) >= 5
    assert {records[number].reason for number in missing} == {"no pattern: check the projector"}
    check_sums(meter, records)
    lost = HEAP.volume_between_mm3(-records[missing[-1]].strip_mm[1], -records[missing[0]].strip_mm[0])
    sound, _ = measure_sound()
    assert meter.totals.volume_mm3 < sound.totals.volume_mm3 - 0.9 * lost


def test_a_frame_without_depth_on_a_standing_belt_is_missing_and_not_what_was_there_before() -> None:
    meter = BeltFlowMeter(empty_belt())
    records: list[FlowRecord] = []
    for number in range(16):
        place = STEP_MM * min(number, 8)
        depth = None if number > 10 else seen(place)
        records += meter.push(depth, number * 10**8, place, frame=str(number))
    records += meter.finish()
    assert list_frames(records, "missing") == list(range(11, 16))
    check_sums(meter, records)
