"""An encoder that fails while nothing lies on the belt: the next material shows it, and the metres that were lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.ledger import BeltRecord
from beltscape.core.progress import Reporter, Silent
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementRun
from beltscape.simulate.faults.delivery import EncoderFault
from tests.measure.flow import moving_belt
from tests.pipeline.live.measurement.test_encoder_faults import list_cases
from tests.synthetic.belt_feed import CAMERA, CAMERAS, IMAGE, FakeMatcher, make_context

Array = NDArray[np.float64]
ROUND_MM, STEP_MM, RATE_HZ = 1860.0, 93.0, 8.0
COUNT, FIRST = 50, 20
"""Number of frames; the fault begins in frame FIRST, in which the gap between two heaps is in view."""
FAULTS = {
    "frozen": EncoderFault(kind="frozen", first=FIRST),
    "frozen, then true again": EncoderFault(kind="frozen", first=FIRST, last=36),
    "reversed": EncoderFault(kind="reversed", first=FIRST),
    "reset": EncoderFault(kind="reset", first=FIRST),
    "wild": EncoderFault(kind="wild", first=FIRST, size=100.0),
    "10 % slow": EncoderFault(kind="slip", first=FIRST, size=0.1),
    "silent": EncoderFault(kind="silent", first=FIRST),
    "silent, then true again": EncoderFault(kind="silent", first=FIRST, last=36),
}


@dataclass(frozen=True, eq=False)
class Heaps(moving_belt.Heap):
    """A heap of 0.9 m that comes again every round: 0.96 m of empty belt, more than the view, between two."""

    start_mm: float = -1460.0
    end_mm: float = -560.0

    def height_mm(self, x: Array, y: Array) -> Array:
        return super().height_mm(x, y % ROUND_MM - ROUND_MM)


HEAPS = Heaps()


class RoundMatcher(FakeMatcher):
    """Returns the depth map of the place that the frame's name contains."""

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        place_mm = float(frame_set.frame.split("|")[1]) % ROUND_MM
        return moving_belt.depth_map(HEAPS, place_mm, seed=7, camera=CAMERA)


def make_track(count: int = COUNT) -> Array:
    return STEP_MM * np.arange(count, dtype=np.float64)


def measure(
    readings_mm: Array, *, start_mm: float = 0.0, matcher: RoundMatcher | None = None
) -> tuple[list[BeltRecord], list[int]]:
    """Return the entries, and the frames with a fault of the encoder; NaN is no reading."""
    context = replace(make_context(), matcher=matcher or RoundMatcher())
    run = MeasurementRun(context, LedgerState(1, 0, None), CAMERAS, lambda: 17, Silent())
    entries: list[BeltRecord] = []
    faulty: list[int] = []
    for number, reading in enumerate(readings_mm):
        frame = f"{number}|{start_mm + number * STEP_MM}"
        time_ns = round(number / RATE_HZ * 1e9)
        position = None if np.isnan(reading) else float(reading)
        frames = FrameSet(frame, dict.fromkeys(CAMERAS, IMAGE), time_ns, position)
        outcome = run.push(frames)
        entries += outcome.entries
        faulty += [number for one in outcome.findings if one.check == "encoder_motion" and one.is_fault]
    return entries + run.finish().entries, faulty


@pytest.fixture(scope="module")
def sound() -> list[BeltRecord]:
    entries, faulty = measure(make_track())
    assert not faulty
    assert all(entry.standing == "valid" for entry in entries)
    return entries


def sum_volume_mm3(entries: Sequence[BeltRecord]) -> float:
    return sum(entry.volume_mm3 for entry in entries)


@pytest.mark.parametrize("name", list_cases(FAULTS, ["frozen, then true again"]))
def test_the_metres_of_the_empty_belt_are_counted_afterwards(name: str, sound: list[BeltRecord]) -> None:
    entries, faulty = measure(FAULTS[name].apply(make_track()))
    assert faulty
    for before, after in pairwise(entries):
        assert after.belt_mm[0] == before.belt_mm[1]
    travel = entries[-1].belt_mm[1] - entries[0].belt_mm[0]
    assert travel == pytest.approx(sound[-1].belt_mm[1] - sound[0].belt_mm[0], rel=0.01)
    assert sum_volume_mm3(entries) == pytest.approx(sum_volume_mm3(sound), rel=0.005)
    numbers = [int(entry.strip.frame.split("|")[0]) for entry in entries if entry.strip is not None]
    assert all(
        entry.standing != "valid"
        for entry, number in zip(entries, numbers, strict=True)
        if FIRST <= number <= min(faulty)
    )


def test_a_scale_that_is_wrong_from_the_start_gives_no_wrong_metres() -> None:
    """By ten times the travel the views have nothing in common. The first records wait for the proof."""
    track = make_track(12)
    entries, faulty = measure(10 * track, start_mm=700.0)
    right, _ = measure(track, start_mm=700.0)
    assert faulty
    assert not any(entry.standing == "valid" for entry in entries)
    travel = entries[-1].belt_mm[1] - entries[0].belt_mm[0]
    assert travel == pytest.approx(right[-1].belt_mm[1] - right[0].belt_mm[0], rel=0.01)
    assert sum_volume_mm3(entries) == pytest.approx(sum_volume_mm3(right), rel=0.005)


class EmptyAfter(RoundMatcher):
    """Returns the depth map of an empty belt from a place on, up to another."""

    def __init__(self, start_mm: float, end_mm: float = np.inf) -> None:
        self._start_mm, self._end_mm = start_mm, end_mm

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        if not self._start_mm <= float(frame_set.frame.split("|")[1]) < self._end_mm:
            return super().reconstruct(frame_set, reporter)
        return moving_belt.depth_map(None, 0.0, seed=7, camera=CAMERA)


@pytest.mark.parametrize("count", [60, pytest.param(120, marks=pytest.mark.thorough)])
def test_an_encoder_that_is_ahead_after_a_standstill_on_an_empty_belt(count: int) -> None:
    """Nothing shows whether the belt stood, until the reading returns where a belt that went on would be."""
    last = count - 15
    track = make_track(count)
    readings = EncoderFault(kind="frozen", first=FIRST, last=last).apply(track)
    entries, faulty = measure(readings, matcher=EmptyAfter(track[FIRST]))
    assert faulty
    assert min(faulty) in (last + 1, last + 2)
    travel = entries[-1].belt_mm[1] - entries[0].belt_mm[1]
    assert travel == pytest.approx(track[-1], rel=0.01)
    uncertain = [
        entry for entry in entries if track[FIRST] < entry.belt_mm[1] - entries[0].belt_mm[1] < track[last]
    ]
    assert all(entry.standing != "valid" for entry in uncertain)
    assert entries[-1].standing == "valid"


@pytest.mark.thorough
def test_material_proves_that_the_encoder_stood_still_on_a_long_empty_belt() -> None:
    """The belt ran as fast before as after it; its metres were seen by nobody as such, and are missing."""
    track = make_track(140)
    readings = EncoderFault(kind="frozen", first=FIRST).apply(track)
    entries, faulty = measure(readings, matcher=EmptyAfter(track[FIRST], track[120]))
    assert 120 <= min(faulty) <= 128
    travel = entries[-1].belt_mm[1] - entries[0].belt_mm[1]
    assert travel == pytest.approx(track[-1], rel=0.01)
    first_mm = entries[0].belt_mm[1]
    late = [entry for entry in entries if track[FIRST] < entry.belt_mm[1] - first_mm]
    assert all(entry.standing != "valid" for entry in late)
    missing_mm = sum(entry.length_mm for entry in entries if entry.standing == "missing")
    assert missing_mm > 0.8 * (track[120] - track[FIRST])


@pytest.mark.thorough
def test_a_jump_after_a_stop_is_no_belt() -> None:
    track = make_track(60)
    stopped = np.minimum(track, track[FIRST]) + np.maximum(track - track[45], 0.0)
    readings = stopped + 800.0 * (np.arange(60) >= 45)
    entries, faulty = measure(readings, matcher=EmptyAfter(track[FIRST] - 1))
    assert faulty
    travel = entries[-1].belt_mm[1] - entries[0].belt_mm[1]
    assert stopped[-1] - 5 * STEP_MM <= travel <= stopped[-1]  # until the encoder is trusted again
