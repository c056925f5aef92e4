"""A belt at rest or creeping is matched once a second, and nothing that happens meanwhile is lost or late."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet, Image
from beltscape.core.ledger import BeltRecord, RecordTag
from beltscape.core.progress import Reporter, Silent
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from beltscape.pipeline.live import measurement_run
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementRun, Outcome
from beltscape.pipeline.reconstructing.monitored_matcher import MonitoredMatcher
from tests.measure.flow.moving_belt import depth_map
from tests.synthetic.belt_feed import CAMERA, CAMERAS, HEAP, RIG, make_context
from tests.thorough import list_cases

FRAMES_PER_S = 8.0
FAST_MM_S = 800.0
PIXEL_MM = 700.0 / 127.0
"""Of the camera on the belt."""
LEARNED = 5
"""Sound frames from which the references are learned."""


@dataclass
class Belt:
    """Where a belt really is, and where its encoder says, in successive frame sets."""

    places_mm: list[float] = field(default_factory=lambda: [0.0])
    readings_mm: list[float] = field(default_factory=lambda: [0.0])
    """Beginning at 5000 mm: the encoder counts from somewhere."""

    def run(self, seconds: float, speed_mm_s: float, encoder_mm_s: float | None = None) -> Belt:
        """Move for a time; the encoder counts with ``encoder_mm_s``, None: what is true."""
        steps = np.arange(1, round(seconds * FRAMES_PER_S) + 1) / FRAMES_PER_S
        counted = speed_mm_s if encoder_mm_s is None else encoder_mm_s
        place, reading = self.places_mm[-1], self.readings_mm[-1]
        self.places_mm += [place + speed_mm_s * float(t) for t in steps]
        self.readings_mm += [reading + counted * float(t) for t in steps]
        return self

    @property
    def count(self) -> int:
        return len(self.places_mm)

    def frames(self, change: Callable[[int, str, Image], Image] | None = None) -> list[FrameSet]:
        """Return the frame sets; ``change`` gets number, camera and image."""
        return [
            FrameSet(
                f"{number}@{place!r}",
                {name: (change or keep)(number, name, show(place, number, name)) for name in CAMERAS},
                round(number / FRAMES_PER_S * 1e9),
                5000.0 + reading,
            )
            for number, (place, reading) in enumerate(zip(self.places_mm, self.readings_mm, strict=True))
        ]


def keep(number: int, camera: str, image: Image) -> Image:
    """Return an image as it is."""
    del number, camera
    return image


_TEXTURE = cv2.GaussianBlur(
    np.random.default_rng(8).normal(0, 1, (4096, CAMERA.size_px[0])).astype(np.float32), (0, 0), 1.2
)


def show(place_mm: float, number: int, camera: str) -> Image:
    """Return the image of a belt at a place, whose texture moves with it, with noise of its own."""
    rows = CAMERA.size_px[1]
    at = np.arange(rows, dtype=np.float32) + np.float32(800 + place_mm / PIXEL_MM)
    columns = np.arange(CAMERA.size_px[0], dtype=np.float32)
    grid_x, grid_y = np.meshgrid(columns, at)
    texture = cv2.remap(_TEXTURE, grid_x, grid_y, cv2.INTER_LINEAR)
    noise = np.random.default_rng([number, CAMERAS.index(camera)]).normal(0, 1.5, texture.shape)
    return np.clip(110 + 60 * texture + noise, 0, 255).astype(np.uint8)


class CountingMatcher:
    """Returns the depth of the belt at the place in the frame's name, with noise of each frame's own."""

    is_inconsistent = False
    findings = ()

    def __init__(self) -> None:
        self.numbers: list[int] = []

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        number, place = frame_set.frame.split("@")
        self.numbers.append(int(number))
        return depth_map(HEAP, float(place), seed=int(number), camera=CAMERA)


@dataclass
class Played:
    """What came of a belt."""

    run: MeasurementRun
    numbers: list[int]
    outcomes: list[Outcome]
    entries: list[BeltRecord]

    def count_matched(self, frames: range) -> int:
        return sum(number in frames for number in self.numbers)

    @property
    def volume_mm3(self) -> float:
        return sum(entry.volume_mm3 for entry in self.entries)

    @property
    def valid_mm(self) -> float:
        return sum(entry.length_mm for entry in self.entries if entry.standing == "valid")

    def list_faults(self, check: str) -> list[int]:
        """Return the numbers of the frames with a fault of a check."""
        return [
            number
            for number, one in enumerate(self.outcomes)
            if any(finding.is_fault and finding.check == check for finding in one.findings)
        ]


def play(
    sets: Iterable[FrameSet], *, flushes: bool = True, tag: Callable[[int], RecordTag] = lambda _: RecordTag()
) -> Played:
    """Measure frame sets; ``flushes``: as the engine does where none waits."""
    matcher = CountingMatcher()
    monitor = ImageMonitor(RIG, HealthSettings(learning_frames=LEARNED))
    context = replace(make_context(), matcher=MonitoredMatcher(matcher, monitor))
    run = MeasurementRun(context, LedgerState(1, 0, None), CAMERAS, lambda: 17, Silent())
    outcomes: list[Outcome] = []
    for number, one in enumerate(sets):
        outcome = run.push(one, (), tag(number))
        early = run.flush() if flushes else replace(outcome, entries=[], findings=())
        entries, findings = [*outcome.entries, *early.entries], (*outcome.findings, *early.findings)
        outcomes.append(replace(outcome, entries=entries, findings=findings))
    last = run.finish()
    entries = [entry for one in outcomes for entry in one.entries] + last.entries
    return Played(run, matcher.numbers, outcomes, entries)


def play_all(sets: Sequence[FrameSet]) -> Played:
    """Measure frame sets, all of which are matched."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measurement_run.RepeatChoice, "is_near", lambda *_: False)
        played = play(sets)
    assert played.numbers == list(range(len(sets)))
    return played


def check_ledger(entries: Sequence[BeltRecord], travel_mm: float, *, by_material: bool = False) -> None:
    """Check that every millimetre is in the ledger once; ``by_material``: within the 1 % of a faulty encoder."""
    for before, after in pairwise(entries):
        assert after.belt_mm[0] == before.belt_mm[1]
    assert entries[-1].belt_mm[1] - entries[0].belt_mm[1] == pytest.approx(
        travel_mm, abs=10.0 if by_material else 1.0
    )


def stop_over_the_heap(rest_s: float) -> tuple[Belt, range]:
    """Return a belt that stops with the heap in view, and the numbers of the frames in which it has stood a while."""
    belt = Belt().run(1.6, FAST_MM_S)
    first = belt.count + round(2 * FRAMES_PER_S)
    belt.run(rest_s, 0.0)
    resting = range(first, belt.count)
    return belt.run(3.0, FAST_MM_S), resting


def test_a_belt_at_rest_is_matched_once_a_second_and_nothing_is_lost() -> None:
    belt, resting = stop_over_the_heap(20.0)
    played, every = play(belt.frames()), play_all(belt.frames())
    assert played.count_matched(resting) == pytest.approx(len(resting) / FRAMES_PER_S, abs=1)
    moving = set(range(belt.count)) - set(range(resting.start - round(2 * FRAMES_PER_S), resting.stop))
    assert moving <= set(played.numbers)
    check_ledger(played.entries, belt.places_mm[-1])
    assert {entry.standing for entry in played.entries} == {"valid"}
    assert played.volume_mm3 == pytest.approx(every.volume_mm3, rel=1e-3)
    assert played.volume_mm3 == pytest.approx(HEAP.volume_mm3, rel=0.01)
    assert max(abs(played.outcomes[number].speed_mm_s) for number in resting) < 1.0
    assert {number for number in resting if played.outcomes[number].is_repeat}.isdisjoint(played.numbers)


def test_the_number_of_frames_of_a_belt_at_rest_does_not_matter_to_sigma() -> None:
    """They show the same belt under the same pattern: their errors are not independent, so that one counts."""
    short, long = stop_over_the_heap(3.0)[0], stop_over_the_heap(16.0)[0]
    few, many, thinned = play_all(short.frames()), play_all(long.frames()), play(long.frames())
    assert many.entries[-1].run_sigma_mm3 == pytest.approx(few.entries[-1].run_sigma_mm3, rel=0.02)
    assert thinned.entries[-1].run_sigma_mm3 == pytest.approx(few.entries[-1].run_sigma_mm3, rel=0.02)


@pytest.mark.parametrize("speed_mm_s", list_cases([5.0, 40.0, 200.0], [5.0, 200.0]))
def test_of_a_creeping_belt_every_millimetre_counts_once(speed_mm_s: float) -> None:
    belt = Belt().run(1.6, FAST_MM_S)
    first = belt.count
    belt.run(24.0, speed_mm_s)
    creeping = range(first, belt.count)
    belt.run(3.0, FAST_MM_S)
    played, every = play(belt.frames()), play_all(belt.frames())
    meter = played.run.meter
    assert meter is not None
    needed = len(creeping) / FRAMES_PER_S * max(1.0, speed_mm_s / meter.step_mm)
    assert 0.7 * needed < played.count_matched(creeping) < 1.15 * needed + 1
    check_ledger(played.entries, belt.places_mm[-1])
    assert played.valid_mm == pytest.approx(every.valid_mm, abs=1.0)
    assert played.volume_mm3 == pytest.approx(every.volume_mm3, rel=2e-3)
    truth = HEAP.volume_mm3
    assert abs(played.volume_mm3 - truth) < 2 * played.entries[-1].run_sigma_mm3
    assert meter.motion.speed == pytest.approx(FAST_MM_S, rel=0.01)
    passed = [played.outcomes[number] for number in creeping if played.outcomes[number].is_repeat]
    assert [one.speed_mm_s for one in passed] == pytest.approx([speed_mm_s] * len(passed), rel=0.01)
    assert passed


@pytest.mark.parametrize("rest_s", [0.0, 10.0])
def test_an_encoder_that_stands_while_the_belt_moves_does_not_look_like_a_belt_at_rest(rest_s: float) -> None:
    belt = Belt().run(1.0, FAST_MM_S).run(rest_s, 0.0)
    frozen = belt.count
    belt.run(3.0, FAST_MM_S, encoder_mm_s=0.0)
    played, every = play(belt.frames()), play_all(belt.frames())
    assert played.numbers[-(belt.count - frozen) :] == list(range(frozen, belt.count))
    noticed = played.list_faults("encoder_motion")[0]
    assert noticed == every.list_faults("encoder_motion")[0]
    assert (noticed - frozen) / FRAMES_PER_S <= 5.0
    check_ledger(played.entries, belt.places_mm[-1], by_material=True)
    assert played.volume_mm3 == pytest.approx(every.volume_mm3, rel=2e-3)


def test_a_slipping_encoder_that_creeps_while_the_belt_runs_is_noticed() -> None:
    belt = Belt().run(1.0, FAST_MM_S).run(10.0, 0.0)
    slips = belt.count
    belt.run(6.0, 250.0, encoder_mm_s=5.0)
    played = play(belt.frames())
    noticed = played.list_faults("encoder_motion")[0]
    assert (noticed - slips) / FRAMES_PER_S <= 2.5
    check_ledger(played.entries, belt.places_mm[-1], by_material=True)
    assert {entry.standing for entry in played.entries[-4:]} == {"degraded"}


def test_an_encoder_that_creeps_under_a_belt_at_rest_is_noticed() -> None:
    belt = Belt().run(1.6, FAST_MM_S).run(5.0, 0.0)
    begins = belt.count
    belt.run(8.0, 0.0, encoder_mm_s=30.0)
    noticed = play(belt.frames()).list_faults("encoder_motion")[0]
    assert (noticed - begins) / FRAMES_PER_S <= 5.0


def test_a_lamp_that_fails_at_rest_is_found_in_its_frame() -> None:
    belt, resting = stop_over_the_heap(15.0)
    fails = resting.start + 30

    def darken(number: int, _: str, image: Image) -> Image:
        return (image * 0.1).astype(np.uint8) if number >= fails else image

    played = play(belt.frames(darken))
    assert played.list_faults("lamp")[0] == fails
    assert fails in played.numbers


@pytest.mark.parametrize("camera", CAMERAS)
def test_an_image_that_changes_at_rest_is_matched_at_once_as_long_as_it_is_new(camera: str) -> None:
    """As of a camera that was moved: its checks get the frames of two seconds as fast as of a moving belt."""
    belt, resting = stop_over_the_heap(20.0)
    moved = resting.start + 40

    def shift(number: int, name: str, image: Image) -> Image:
        return np.roll(image, 3, axis=1) if number >= moved and name == camera else image

    played = play(belt.frames(shift))
    assert not played.outcomes[
        moved
    ].is_repeat  # the other of two cameras seems to repeat its image in this frame
    attentive = range(moved + 1, moved + round(2 * FRAMES_PER_S))
    assert played.count_matched(attentive) == len(attentive)
    calm = range(attentive.stop, resting.stop)
    assert played.count_matched(calm) == pytest.approx(len(calm) / FRAMES_PER_S, abs=1)


def test_a_camera_without_an_image_and_another_batch_are_matched_at_once() -> None:
    belt, resting = stop_over_the_heap(15.0)
    sets, lost, other = belt.frames(), resting.start + 20, resting.start + 60
    sets[lost] = replace(sets[lost], images={"cam0": sets[lost].images["cam0"]})
    played = play(sets, tag=lambda number: RecordTag("coal", batch=1 + (number >= other)))
    assert other in played.numbers
    assert not played.outcomes[lost].is_repeat
    assert played.entries[-1].batch == 2


def test_the_decision_depends_on_no_thread() -> None:
    belt, _ = stop_over_the_heap(12.0)
    early, late = play(belt.frames()), play(belt.frames(), flushes=False)
    assert early.numbers == late.numbers
    assert [repr(entry) for entry in early.entries] == [repr(entry) for entry in late.entries]


def test_until_the_references_are_learned_and_without_an_encoder_everything_is_matched() -> None:
    belt = Belt().run(4.0, 0.0)
    assert play(belt.frames()).numbers[: LEARNED + 1] == list(range(LEARNED + 1))
    silent = [replace(one, position_mm=None) for one in belt.frames()]
    assert play(silent).numbers == list(range(belt.count))
