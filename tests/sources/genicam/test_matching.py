"""Matching of images to instants: no image twice, instants never mixed, order kept."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.sources.genicam.matching import (
    CameraImage,
    InstantMatcher,
    MatchedInstant,
    MatchingRules,
    count_missing,
)
from tests.thorough import examples

MS = 1_000_000
PERIOD = 100 * MS
RULES = MatchingRules(window_ns=40 * MS, skew_ns=5 * MS, timeout_ns=300 * MS)
CAMERAS = ("cam0", "cam1", "cam2", "cam3")


@dataclass
class Wire:
    """One camera and its cable, as a test wants them."""

    offset_ns: int = 0
    drift_ppm: float = 0.0
    jitter_ns: int = 0
    """Its instants are off by at most this."""
    first_id: int = 1
    dropped: set[int] = field(default_factory=set)
    duplicates: set[int] = field(default_factory=set)
    delays_ns: dict[int, int] = field(default_factory=dict)
    """Instant → delay beyond the usual."""
    stalls: list[tuple[int, int]] = field(default_factory=list)
    """From instant, for so many instants: all that falls into it comes at its end."""

    def shots(self, name: str, instants: range, seed: int) -> list[CameraImage[int]]:
        rng = np.random.default_rng(seed)
        out, frame_id = [], self.first_id
        earliest = 0
        for k in instants:
            taken = k * PERIOD + int(rng.integers(-self.jitter_ns, self.jitter_ns + 1))
            latency = 2 * MS + int(rng.integers(0, 2 * MS)) + self.delays_ns.get(k, 0)
            camera_ns = self.offset_ns + round(taken * (1 - self.drift_ppm * 1e-6))
            ends = [(start + length) * PERIOD for start, length in self.stalls if start <= k < start + length]
            earliest = max([earliest, taken + latency, *ends])  # a camera's images come in their order
            shot = CameraImage(name, frame_id, camera_ns, earliest, k)
            frame_id = frame_id % 65535 + 1
            if k not in self.dropped:
                out.append(shot)
                if k in self.duplicates:
                    out.append(shot)
        return out


def played(
    wires: dict[str, Wire], count: int, rules: MatchingRules = RULES, seed: int = 0
) -> tuple[InstantMatcher[int], list[tuple[int, MatchedInstant[int]]]]:
    """The matcher after ``count`` instants, and what it gave out when."""
    matcher: InstantMatcher[int] = InstantMatcher(tuple(wires), "cam0", rules)
    shots = [
        s
        for i, (name, wire) in enumerate(wires.items())
        for s in wire.shots(name, range(10, count), seed + i)
    ]
    given_out: list[tuple[int, MatchedInstant[int]]] = []

    def advance_to(now_ns: int) -> None:
        while (deadline := matcher.deadline_ns()) is not None and deadline <= now_ns:
            given_out.extend((deadline, one) for one in matcher.pop_due(deadline))

    for shot in sorted(shots, key=lambda s: s.arrival_ns):
        advance_to(shot.arrival_ns)
        matcher.add(shot, shot.arrival_ns)
        given_out.extend((shot.arrival_ns, one) for one in matcher.pop_due(shot.arrival_ns))
    advance_to(2**62)
    return matcher, given_out


def assert_laws(given_out: list[tuple[int, MatchedInstant[int]]]) -> None:
    instants = []
    for _, one in given_out:
        seen = {shot.payload for shot in one.shots.values()}
        assert len(seen) == 1, "two instants in one set"
        assert all(name == shot.camera for name, shot in one.shots.items())
        instants.append(seen.pop())
    assert instants == sorted(set(instants)), "order, or an instant given out twice"
    times = [one.time_ns for _, one in given_out]
    assert all(b > a for a, b in pairwise(times))


wires = st.builds(
    Wire,
    offset_ns=st.integers(0, 2 * 10**18),
    drift_ppm=st.floats(-100, 100),
    jitter_ns=st.integers(0, 2 * MS),
    first_id=st.integers(1, 65535),
    dropped=st.sets(st.integers(10, 60), max_size=30),
    duplicates=st.sets(st.integers(10, 60), max_size=5),
    delays_ns=st.dictionaries(st.integers(10, 60), st.integers(0, 3000 * MS), max_size=12),
    stalls=st.lists(st.tuples(st.integers(10, 60), st.integers(1, 25)), max_size=2),
)


@given(st.lists(wires, min_size=2, max_size=4), st.integers(0, 1000))
def test_instants_are_never_mixed_with_lost_or_late_images(each, seed):
    _, given_out = played(dict(zip(CAMERAS, each, strict=False)), 60, seed=seed)
    assert_laws(given_out)


@examples(12)
@given(
    st.lists(st.integers(0, 10**18), min_size=4, max_size=4),
    st.lists(st.floats(-80, 80), min_size=4, max_size=4),
)
def test_prompt_images_give_complete_instants(offsets, drifts):
    cameras = {n: Wire(o, d) for n, o, d in zip(CAMERAS, offsets, drifts, strict=True)}
    matcher, given_out = played(cameras, 200)
    assert_laws(given_out)
    whole = [one for _, one in given_out if len(one.shots) == 4]
    assert len(whole) >= 200 - 10 - 5
    assert all(matcher.statistics(name).late == 0 for name in CAMERAS)


def test_drift_is_estimated():
    wires = {"cam0": Wire(drift_ppm=40.0), "cam1": Wire(5 * 10**12, drift_ppm=-60.0, jitter_ns=0)}
    matcher, _ = played(wires, 400)
    assert matcher.clock("cam0").drift_ppm == pytest.approx(40, abs=15)
    assert matcher.clock("cam1").drift_ppm == pytest.approx(-60, abs=15)


def test_an_instant_waits_no_longer_than_allowed_and_only_once():
    wires = {"cam0": Wire(), "cam1": Wire(10**15), "cam2": Wire(10**12, dropped=set(range(40, 80)))}
    matcher, given_out = played(wires, 80)
    waits = {next(iter(one.shots.values())).payload: now - one.time_ns for now, one in given_out}
    assert waits[40] == pytest.approx(300 * MS, abs=10 * MS)
    assert all(waits[k] < 10 * MS for k in range(45, 80))
    statistics = matcher.statistics("cam2")
    assert statistics.silent
    assert statistics.missed == 40


def test_first_camera_waits_for_the_others_at_the_start():
    rules = MatchingRules(40 * MS, 5 * MS, 300 * MS, start_ns=2000 * MS)
    late = Wire(dropped=set(range(10, 20)))
    _, given_out = played({"cam0": Wire(), "cam1": late}, 40, rules)
    assert set(given_out[0][1].shots) == {"cam0", "cam1"}
    _, given_out = played({"cam0": Wire(), "cam1": Wire(dropped=set(range(10, 60)))}, 60, rules)
    assert given_out[0][1].shots["cam0"].payload == pytest.approx(10 + 5 + 20, abs=2)


@pytest.mark.parametrize("seed", range(8))
def test_first_instant_has_all_cameras_however_late_its_first_image_came(seed):
    rules = MatchingRules(40 * MS, 8 * MS, 300 * MS, start_ns=2000 * MS)
    late = Wire(delays_ns=dict.fromkeys(range(15, 20), 1 * MS))
    always_late = Wire(delays_ns=dict.fromkeys(range(60), 4 * MS))
    wires = {"cam0": late, "cam1": Wire(), "cam2": always_late}
    _, given_out = played(wires, 40, rules, seed)
    assert set(given_out[0][1].shots) == set(wires)


def test_reopened_camera_has_a_new_clock_and_count():
    before = Wire(10**15, first_id=900).shots("cam1", range(10, 40), 1)
    after = Wire(5 * 10**9, first_id=1).shots("cam1", range(70, 100), 2)
    other = Wire().shots("cam0", range(10, 100), 3)
    matcher: InstantMatcher[int] = InstantMatcher(("cam0", "cam1"), "cam0", RULES)
    given_out = []
    for shot in sorted([*before, *after, *other], key=lambda s: s.arrival_ns):
        if shot is after[0]:
            matcher.on_reopened("cam1")
        matcher.add(shot, shot.arrival_ns)
        given_out.extend((shot.arrival_ns, one) for one in matcher.pop_due(shot.arrival_ns))
    assert_laws(given_out)
    with_both = [one.shots["cam0"].payload for _, one in given_out if len(one.shots) == 2]
    assert max(with_both) == 99
    assert min(k for k in with_both if k >= 70) <= 76
    assert matcher.statistics("cam1").skipped == 0


def test_core_may_be_absent_while_time_increases():
    wires = {
        "cam0": Wire(10**17, 50, dropped=set(range(200, 300))),
        "cam1": Wire(3, -50),
        "cam2": Wire(10**9),
    }
    _, given_out = played(wires, 400)
    assert_laws(given_out)
    steps = np.diff([one.time_ns for _, one in given_out])
    assert np.all(np.abs(steps - PERIOD) < 3 * MS)


def test_image_too_far_from_the_others_is_skipped_and_counted():
    wires = {"cam0": Wire(), "cam1": Wire(), "cam2": Wire()}
    matcher: InstantMatcher[int] = InstantMatcher(tuple(wires), "cam0", RULES)
    given_out: list[MatchedInstant[int]] = []
    for k in range(30):
        for name in wires:
            late = 12 * MS if name == "cam2" and k >= 20 else 0
            matcher.add(
                CameraImage(name, k + 1, k * PERIOD + late, k * PERIOD + late + MS, k), k * PERIOD + late + MS
            )
        given_out.extend(matcher.pop_due((k + 1) * PERIOD))
    assert set(given_out[-1].shots) == {"cam0", "cam1"}
    statistics = matcher.statistics("cam2")
    assert statistics.out_of_skew
    assert statistics.skew_ns == 12 * MS
    assert not matcher.statistics("cam1").out_of_skew


def test_constant_offset_on_a_common_pulse_is_clock_error():
    rules = MatchingRules(40 * MS, 5 * MS, 300 * MS, common_pulse=True)
    matcher: InstantMatcher[int] = InstantMatcher(("cam0", "cam1"), "cam0", rules)
    for k in range(60):
        matcher.add(CameraImage("cam0", k + 1, k * PERIOD, k * PERIOD + MS, k), k * PERIOD + MS)
        jump = 2 * MS if k == 59 else 0
        shot = CameraImage("cam1", k + 1, 7 * 10**14 + k * PERIOD + jump, k * PERIOD + 8 * MS + jump, k)
        matcher.add(shot, k * PERIOD + 8 * MS)
        matcher.pop_due(k * PERIOD + 8 * MS)
    assert matcher.statistics("cam1").skew_ns == pytest.approx(2 * MS, abs=MS // 10)


def test_clock_that_is_not_shared_is_reported():
    rules = MatchingRules(40 * MS, 5 * MS, 300 * MS, clocks="ptp")
    wires = {"cam0": Wire(10**18), "cam1": Wire(10**18), "cam2": Wire(10**18 + 37 * 10**9)}
    matcher, given_out = played(wires, 50, rules)
    assert_laws(given_out)
    assert matcher.statistics("cam2").unsynchronised
    assert not matcher.statistics("cam1").unsynchronised
    assert all(set(one.shots) <= {"cam0", "cam1"} for _, one in given_out)
    assert len(given_out[-1][1].shots) == 2


def test_clock_set_while_running_is_estimated_again():
    matcher: InstantMatcher[int] = InstantMatcher(("cam0", "cam1"), "cam0", RULES)
    given_out = []
    for k in range(120):
        for name in ("cam0", "cam1"):
            stepped = -3600 * 10**9 if name == "cam1" and k >= 60 else 0
            camera_ns = 10**16 + k * PERIOD + stepped
            matcher.add(CameraImage(name, k + 1, camera_ns, k * PERIOD + MS, k), k * PERIOD + MS)
        given_out.extend((0, one) for one in matcher.pop_due(k * PERIOD + MS))
        given_out.extend((0, one) for one in matcher.pop_due(k * PERIOD + 90 * MS))
    assert_laws(given_out)
    assert len(given_out[-1][1].shots) == 2
    assert sum(len(one.shots) == 1 for _, one in given_out) <= 12


@pytest.mark.parametrize(
    ("before", "after", "lost"),
    [
        (1, 2, 0),
        (1, 5, 3),
        (65535, 1, 0),
        (65534, 2, 2),
        (9, 1, 0),
        (2**40, 2**40 + 2, 1),
        (7, 7, 0),
        (8, 7, 0),
    ],
)
def test_missing_images_are_counted(before, after, lost):
    assert count_missing(before, after) == lost
