"""Encoder and material contradict each other: nothing is valid, and the ledger counts the metres by the material."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.ledger import BeltRecord
from beltscape.core.progress import Reporter, Silent
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementRun
from tests.measure.flow import moving_belt
from tests.measure.flow.moving_belt import Heap, depth_map
from tests.synthetic.belt_feed import CAMERA, CAMERAS, IMAGE, FakeMatcher, make_context
from tests.thorough import list_cases

Array = NDArray[np.floating]
HEAP = Heap(start_mm=-60_000, end_mm=900, seed=8)
STEP_MM = 75.0
RATE_HZ = 8.0
COUNT, FIRST, END = 24, 7, 14
"""Number of frames; the fault is in the frames from FIRST to before END."""
FAULT = np.arange(COUNT)
FAULT = (FAULT >= FIRST) & (FAULT < END)


class PlaceMatcher(FakeMatcher):
    """Returns the depth map of the place that the frame's name contains."""

    def __init__(self, heap: Heap | None = HEAP, camera: Camera = CAMERA) -> None:
        self._heap, self.camera = heap, camera

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        place_mm = float(frame_set.frame.split("|")[1])
        return depth_map(self._heap, place_mm, seed=3, camera=self.camera)


SHARP_MATCHER = PlaceMatcher(camera=moving_belt.CAMERA)
"""Its pixels are small enough to measure a slip of some tenths of a per cent."""


def measure(
    places_mm: Array, encoder_mm: Sequence[float | None], matcher: PlaceMatcher | None = None
) -> tuple[list[BeltRecord], list[list[Finding]]]:
    """Return the entries, and the encoder's findings by frame set."""
    matcher = matcher or PlaceMatcher()
    context = replace(make_context(matcher.camera), matcher=matcher)
    run = MeasurementRun(context, LedgerState(1, 0, None), CAMERAS, lambda: 17, Silent())
    entries: list[BeltRecord] = []
    findings: list[list[Finding]] = []
    for number, (place, reading) in enumerate(zip(places_mm, encoder_mm, strict=True)):
        time_ns = round(number / RATE_HZ * 1e9)
        outcome = run.push(FrameSet(f"{number}|{place}", dict.fromkeys(CAMERAS, IMAGE), time_ns, reading))
        entries += outcome.entries
        findings.append([one for one in outcome.findings if one.check == "encoder_motion"])
    return entries + run.finish().entries, findings


def list_not_valid(entries: Sequence[BeltRecord]) -> list[int]:
    return [
        int(entry.strip.frame.split("|")[0])
        for entry in entries
        if entry.strip is not None and entry.standing != "valid"
    ]


def check_ledger(entries: Sequence[BeltRecord], travel_mm: float) -> None:
    """Check that the entries follow each other and add up to the belt that passed."""
    for before, after in pairwise(entries):
        assert after.belt_mm[0] == before.belt_mm[1]
    assert entries[-1].belt_mm[1] - entries[0].belt_mm[1] == pytest.approx(travel_mm, rel=0.01)
    assert all(entry.length_mm > 0 for entry in entries)
    for entry in entries:
        assert (entry.reason == "") == (entry.standing == "valid")


def list_positions(step_mm: float = STEP_MM) -> Array:
    return step_mm * np.arange(COUNT)


def alter_steps(places_mm: Array, factor: float) -> Array:
    """Return readings whose steps are multiplied by a factor during the fault."""
    steps = np.diff(places_mm, prepend=places_mm[0])
    return np.cumsum(np.where(FAULT, factor * steps, steps))


def jump_wildly(places_mm: Array) -> Array:
    return np.where(FAULT, np.random.default_rng(4).uniform(-5000, 20_000, COUNT), places_mm)


FAULTS: dict[str, Callable[[Array], Array]] = {
    "frozen, then catching up": lambda p: np.where(FAULT, p[FIRST - 1], p),
    "lifted, then counting on": lambda p: alter_steps(p, 0.0),
    "reversed": lambda p: alter_steps(p, -1.0),
    "wild": jump_wildly,
    "10 % slow": lambda p: alter_steps(p, 0.9),
    "wrong scale": lambda p: alter_steps(p, 10.0),
}
JUMPS: dict[str, Callable[[Array], Array]] = {
    "by 300 mm": lambda p: p + 300.0 * (p >= p[FIRST]),
    "by 5 m": lambda p: p + 5000.0 * (p >= p[FIRST]),
    "reset to 0": lambda p: p - p[FIRST] * (p >= p[FIRST]),
}


@cache
def measure_sound_volume_mm3() -> float:
    """Return the volume by an encoder without a fault."""
    track = list_positions()
    entries, _ = measure(track, [float(place) for place in track])
    return sum(entry.volume_mm3 for entry in entries)


@pytest.mark.parametrize("fault", list_cases(FAULTS, ["frozen, then catching up"]))
def test_nothing_is_valid_from_the_first_contradicted_frame_on(fault: str) -> None:
    track = list_positions()
    entries, findings = measure(track, [float(reading) for reading in FAULTS[fault](track)])
    check_ledger(entries, track[-1])
    not_valid = list_not_valid(entries)
    assert set(range(FIRST, END)) <= set(not_valid)
    assert set(not_valid) <= set(range(FIRST, END + 6))  # trusted again after several steps that agree
    assert any(one.is_fault for made in findings[: FIRST + 3] for one in made)
    assert not any(one.is_fault for made in findings[:FIRST] for one in made)
    assert sum(entry.volume_mm3 for entry in entries) == pytest.approx(measure_sound_volume_mm3(), rel=0.005)


@pytest.mark.parametrize("jump", list_cases(JUMPS, ["by 300 mm"]))
def test_a_jump_is_no_belt_and_the_encoder_is_trusted_again_after_it(jump: str) -> None:
    track = list_positions()
    entries, findings = measure(track, [float(reading) for reading in JUMPS[jump](track)])
    check_ledger(entries, track[-1])
    assert list_not_valid(entries) == list(range(FIRST, FIRST + 4))
    assert not any(one.is_fault for one in findings[-1])


@pytest.mark.thorough
@pytest.mark.parametrize(("slip", "frames"), [(0.01, 30), (0.03, 5)])
def test_slip_adds_up_until_it_exceeds_its_uncertainty(slip: float, frames: int) -> None:
    track = list_positions()
    steps = np.diff(track, prepend=track[0]) * np.where(np.arange(COUNT) >= FIRST, 1 - slip, 1.0)
    entries, findings = measure(track, [float(reading) for reading in np.cumsum(steps)], SHARP_MATCHER)
    check_ledger(entries, track[-1])
    faults = [one for made in findings[: FIRST + frames] for one in made if one.is_fault]
    assert faults
    assert faults[-1].value == pytest.approx(-slip, abs=4 * faults[-1].sigma + 0.002)
    assert list_not_valid(entries)[-1] == COUNT - 1


@pytest.mark.parametrize(
    ("step_mm", "slip"), [(75.0, 0.004), pytest.param(150.0, 0.003, marks=pytest.mark.thorough)]
)
def test_a_small_slip_is_a_trend_with_sigma_that_degrades_nothing(step_mm: float, slip: float) -> None:
    track = list_positions(step_mm)
    entries, findings = measure(track, [(1 - slip) * float(place) for place in track], SHARP_MATCHER)
    assert list_not_valid(entries) == []
    (last,) = findings[-1]
    assert (last.is_fault, last.effect, last.cause) == (True, "none", "encoder_slip")
    assert abs(last.value + slip) < 2 * last.sigma
    assert 0 < last.sigma < 0.0015


@pytest.mark.thorough
@pytest.mark.parametrize("step_mm", [330.0, 460.0])
def test_fast_belts_whose_views_hardly_overlap(step_mm: float) -> None:
    track = list_positions(step_mm)
    entries, _ = measure(track, [float(reading) for reading in FAULTS["frozen, then catching up"](track)])
    check_ledger(entries, track[-1])
    assert set(range(FIRST, END)) <= set(list_not_valid(entries))


@pytest.mark.parametrize(
    ("step_mm", "is_empty"),
    [
        *(
            pytest.param(step_mm, False, marks=pytest.mark.thorough)
            for step_mm in (20.0, 75.0, 330.0, 600.0, 900.0)
        ),
        (75.0, True),
    ],
)
def test_a_sound_encoder_is_not_accused(step_mm: float, is_empty: bool) -> None:
    """Also where the views have nothing in common, and where nothing lies on the belt."""
    track = list_positions(step_mm)
    jitter = np.random.default_rng(6).normal(0, 0.4, COUNT)
    matcher = PlaceMatcher(None if is_empty else HEAP)
    _, findings = measure(track, [float(reading) for reading in track + jitter], matcher)
    assert not any(one.is_fault for made in findings for one in made)


@pytest.mark.thorough
def test_a_stop_and_a_start_accuse_nobody() -> None:
    speed = np.concatenate([np.full(12, 75.0), np.linspace(75, 0, 5), np.zeros(10), np.linspace(0, 75, 5)])
    track = np.cumsum(speed)
    entries, findings = measure(track, [float(place) for place in track])
    assert list_not_valid(entries) == []
    assert not any(one.is_fault for made in findings for one in made)


@pytest.mark.thorough
def test_frozen_images_give_no_multiples_of_the_load() -> None:
    track = list_positions()
    frozen = np.where(np.arange(COUNT) >= FIRST, track[FIRST - 1], track)
    entries, findings = measure(frozen, [float(place) for place in track])
    assert set(range(FIRST, COUNT)) <= set(list_not_valid(entries))
    assert any(one.is_fault for made in findings[: FIRST + 4] for one in made)
    before, _ = measure(track[:FIRST], [float(place) for place in track[:FIRST]])
    assert sum(entry.volume_mm3 for entry in entries) == pytest.approx(
        sum(entry.volume_mm3 for entry in before), rel=0.05
    )


def test_the_metres_of_repeated_images_are_missing_and_measuring_recovers() -> None:
    track = list_positions()
    shown = np.where((np.arange(COUNT) >= FIRST) & (np.arange(COUNT) < END), track[FIRST - 1], track)
    entries, findings = measure(shown, [float(place) for place in track])
    check_ledger(entries, track[-1])
    assert any(one.cause == "encoder_stalled" for one in findings[FIRST + 1])
    texts = [one.text for made in findings for one in made if one.is_fault]
    assert all("counts 0.0" in text and "stands still" in text for text in texts)
    assert not any(one.is_fault for made in findings[END + 2 :] for one in made)
    assert entries[-1].standing == "valid"
    assert sum(entry.volume_mm3 for entry in entries) <= 1.005 * measure_sound_volume_mm3()


@pytest.mark.thorough
def test_nothing_is_lost_where_every_second_image_set_repeats() -> None:
    track = list_positions()
    shown = [track[number - (number % 2 if FIRST <= number < COUNT - 1 else 0)] for number in range(COUNT)]
    entries, findings = measure(np.array(shown), [float(place) for place in track])
    check_ledger(entries, track[-1])
    assert any(one.cause == "encoder_stalled" for made in findings for one in made)
    assert sum(entry.volume_mm3 for entry in entries) == pytest.approx(measure_sound_volume_mm3(), rel=0.03)


def test_a_silent_encoder_that_returns_with_another_count() -> None:
    track = list_positions()
    readings = [
        None if silent else float(place) - 2000 * (number >= END)
        for number, (place, silent) in enumerate(zip(track, FAULT, strict=True))
    ]
    entries, findings = measure(track, readings)
    check_ledger(entries, track[-1])
    assert list_not_valid(entries) == list(range(FIRST, END + 4))
    causes = {one.cause for made in findings[FIRST:END] for one in made if one.is_fault}
    assert causes == {"encoder_silent"}


@pytest.mark.thorough
def test_one_lost_reading_accuses_nobody() -> None:
    track = list_positions()
    readings = [None if number % 7 == 5 else float(place) for number, place in enumerate(track)]
    entries, findings = measure(track, readings)
    check_ledger(entries, track[-1])
    assert list_not_valid(entries) == []
    assert not any(one.is_fault for made in findings for one in made)


def test_an_encoder_that_counts_in_reverse_from_the_start() -> None:
    track = list_positions()
    context = replace(make_context(), matcher=PlaceMatcher())
    context = replace(context, flow=context.flow.model_copy(update={"direction": None}))
    run = MeasurementRun(context, LedgerState(1, 0, None), CAMERAS, lambda: 17, Silent())
    entries: list[BeltRecord] = []
    for number, place in enumerate(track):
        frames = FrameSet(
            f"{number}|{place}", dict.fromkeys(CAMERAS, IMAGE), round(number / RATE_HZ * 1e9), -float(place)
        )
        entries += run.push(frames).entries
    entries += run.finish().entries
    assert entries[-1].belt_mm[1] - entries[0].belt_mm[1] == pytest.approx(track[-1], rel=0.01)
    assert len(list_not_valid(entries)) == len([entry for entry in entries if entry.strip is not None])
