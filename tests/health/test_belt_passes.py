"""What is stuck to the belt, and marks of the belt itself, over several revolutions of a small belt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.core.findings import Finding
from beltscape.health.belt.monitor import BeltMonitor, make_beside_finding, make_event_findings
from beltscape.health.belt.passes import BeltEvent, BeltPasses
from beltscape.health.belt.residue import CellRows
from beltscape.health.belt.splices import find_splice
from beltscape.health.settings import BeltLimits
from tests.measure.flow.moving_belt import CAMERA, Heap, depth_map, make_empty_belt
from tests.thorough import list_cases

LENGTH_MM, STEP_MM = 4000.0, 160.0
Surface = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.floating]]
"""Height on the belt at x and the belt coordinate s."""
REFERENCE = make_empty_belt()
RAYS = CAMERA.rays()


def run_belt(surface: Surface, revolutions: float) -> list[Finding]:
    """All findings of a belt that runs so far."""
    monitor = BeltMonitor(REFERENCE, BeltLimits(belt_length_m=LENGTH_MM / 1000))
    out: list[Finding] = []
    for number in range(int(revolutions * LENGTH_MM / STEP_MM)):
        position = number * STEP_MM
        empty = depth_map(None, 0.0, seed=number)
        x, y = RAYS[..., 0] * empty.depth_mm, -RAYS[..., 1] * empty.depth_mm
        s = position - y
        layer = surface(x, s % LENGTH_MM)
        depth = replace(empty, depth_mm=(empty.depth_mm - layer).astype(np.float32))
        out += [*monitor.check(depth), *monitor.follow(position, 1)]
    return out


def last(findings: list[Finding], check: str) -> float:
    return [finding.value for finding in findings if finding.check == check][-1]


def cake(x: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.floating]:
    """A cake of 8 mm, 150 mm wide and 300 mm long."""
    return 8.0 * ((np.abs(x - 80) < 75) & (np.abs(s - 1500) < 150))


CAKE_L = 8.0 * 150 * 300 / 1e6


def test_clean_belt_has_no_carry_back_and_no_marks():
    findings = run_belt(lambda x, _: 0 * x, 0.9)
    assert not any(finding.is_fault for finding in findings)
    assert not {"splice", "torn_edge_left", "torn_edge_right"} & {finding.check for finding in findings}
    assert last(findings, "carry_back_total") < 0.02


def test_carry_back_has_its_own_total_and_is_no_rise():
    findings = run_belt(cake, 1.6)
    assert last(findings, "carry_back_total") == pytest.approx(2 * CAKE_L, rel=0.15)
    assert last(findings, "carry_back_stuck") == pytest.approx(CAKE_L, rel=0.3)
    shifts = [finding for finding in findings if finding.check == "zero_shift"]
    assert not any(shift.is_fault for shift in shifts)
    assert max(abs(shift.value) for shift in shifts) < 0.1
    assert any(finding.is_fault for finding in findings if finding.check == "carry_back")


def run_rows(
    surface: Surface, revolutions: float, *, scrape_after_mm: float = np.inf
) -> tuple[BeltPasses, list[BeltEvent]]:
    """Follow a belt by its rows alone, as they are where the belt lies as learned."""
    low, high = REFERENCE.belt.across_mm
    side = (high - low) / 32
    x = low + side * (np.arange(32, dtype=np.float64) + 0.5)
    y = side * (np.arange(24, dtype=np.float64) - 11.5)
    passes, events = BeltPasses(side, LENGTH_MM, 1000 * BeltLimits().empty_m), list[BeltEvent]()
    for number in range(int(revolutions * LENGTH_MM / STEP_MM)):
        s = np.asarray(number * STEP_MM - y[:, None], np.float64)
        over = np.where(s < scrape_after_mm, surface(x[None], s % LENGTH_MM), 0.0)
        over = np.where(over < -100, np.nan, over).astype(np.float64)
        rows = CellRows(y, over, np.full(over.shape, 0.1), np.abs(over) < 0.3, side)
        events += passes.add(rows, number * STEP_MM, 1, find_splice(rows))
    return passes, events


def test_spillage_that_does_not_return_is_not_stuck():
    passes, _ = run_rows(cake, 2.0, scrape_after_mm=LENGTH_MM - 500)
    assert passes.residue_mm3 == pytest.approx(1e6 * CAKE_L, rel=0.15)
    assert passes.stuck_mm3 < 1e5 * CAKE_L


def test_splice_is_recognised_with_its_position():
    passes, splices = run_rows(lambda x, s: 2.0 * (np.abs(s - 2300) < 60) + 0 * x, 2.0)
    np.testing.assert_allclose([each.position_mm for each in splices], [2300, 2300], atol=40)
    assert [(each.kind, each.passes) for each in splices] == [("splice", 1), ("splice", 2)]
    assert passes.residue_mm3 == 0.0


@pytest.mark.parametrize(
    ("height_mm", "length_mm", "bias_deg"),
    [(3.0, 200.0, 20.0), (1.2, 120.0, -25.0), (8.0, 90.0, 0.0), (5.0, 150.0, 40.0)],
)
@pytest.mark.parametrize("load", list_cases(["none", "middle", "left"], ["none", "left"]))
def test_oblique_splice_beside_a_load_is_recognised_once_each_time(
    height_mm: float, length_mm: float, bias_deg: float, load: str
):
    slope = np.tan(np.deg2rad(bias_deg))
    reach = {"none": (0.0, 0.0), "middle": (-70.0, 90.0), "left": (-110.0, 10.0)}[load]

    def surface(x: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.floating]:
        spliced = height_mm * (np.abs(s - 2300 + slope * x) < length_mm / 2)
        ripples = 55.0 + 20.0 * np.sin(x / 17.0) * np.sin(s / 23.0)
        return np.where((x >= reach[0]) & (x < reach[1]), ripples, spliced)

    passes, events = run_rows(surface, 2.0)
    np.testing.assert_allclose([each.position_mm for each in events], [2300, 2300], atol=40)
    assert [(each.kind, each.passes, each.is_loaded) for each in events] == [
        ("splice", 1, load != "none"),
        ("splice", 2, load != "none"),
    ]
    assert events[0].size_mm == pytest.approx(height_mm, rel=0.05)
    assert events[0].length_mm == pytest.approx(length_mm, abs=45)
    if (
        abs(bias_deg) < 30
    ):  # a steeper one is longer than this view; what is seen of it as a whole is no residue
        assert passes.residue_mm3 < 2e4


def patches(x: NDArray[np.float64], s: NDArray[np.float64], thickness_mm: float) -> NDArray[np.floating]:
    """Cakes with gaps between them, on half of the belt."""
    return thickness_mm * (np.sin(x / 28.0 + np.sin(s / 90.0)) * np.sin(s / 41.0) > 0)


@pytest.mark.parametrize("thickness_mm", list_cases([2.0, 6.0], [2.0]))
def test_carry_back_is_found_beside_a_load_and_is_no_splice(thickness_mm: float):
    def surface(x: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.floating]:
        return np.where(np.abs(x) < 80, 60.0, patches(x, s, thickness_mm))

    passes, events = run_rows(surface, 2.0)
    assert not events
    assert passes.beside_load.thickness_mm == pytest.approx(thickness_mm / 2, rel=0.3)
    finding = make_beside_finding(passes.beside_load, 0.05, 500.0, BeltLimits())
    assert finding is not None
    assert (finding.check, finding.effect) == ("carry_back", "degraded")
    assert 0.2 * thickness_mm < finding.systematic_mm < 0.5 * thickness_mm


def test_material_on_one_side_of_a_load_is_no_carry_back():
    def surface(x: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.floating]:
        return np.where(np.abs(x) < 80, 60.0, np.where(x > 0, patches(x, s, 9.0), 0.0))

    passes, _ = run_rows(surface, 1.5)
    assert make_beside_finding(passes.beside_load, 0.05, 500.0, BeltLimits()) is None


def test_torn_edge_is_recognised_with_its_position():
    high = REFERENCE.belt.across_mm[1]
    _, tears = run_rows(lambda x, s: -400.0 * ((x > high - 50) & (np.abs(s - 1200) < 100)), 1.6)
    np.testing.assert_allclose([tear.position_mm for tear in tears], [1200, 1200], atol=60)
    assert {tear.kind for tear in tears} == {"torn right edge"}
    (finding, _) = make_event_findings(tears, 20.0)
    assert finding.check == "torn_edge_right" and finding.is_fault


def loaded_and_torn(
    x: NDArray[np.float64], s: NDArray[np.float64], *, half_width_mm: float
) -> NDArray[np.floating]:
    """A load without a gap, and a notch of the right edge."""
    load = 60.0 * (np.abs(x) < half_width_mm) + 0 * s
    return np.where((x > REFERENCE.belt.across_mm[1] - 50) & (np.abs(s - 1200) < 100), -400.0, load)


def test_torn_edge_beside_a_load_is_recognised_and_degrades_its_record():
    _, tears = run_rows(lambda x, s: loaded_and_torn(x, s, half_width_mm=100.0), 1.6)
    np.testing.assert_allclose([tear.position_mm for tear in tears], [1200, 1200], atol=60)
    (finding, _) = make_event_findings(tears, 20.0)
    assert (finding.check, finding.effect, finding.is_momentary) == ("torn_edge_right", "degraded", True)
    _, hidden = run_rows(lambda x, s: loaded_and_torn(x, s, half_width_mm=400.0), 1.6)
    assert not hidden


def test_ground_that_shows_through_a_notch_is_not_the_belt():
    high = REFERENCE.belt.across_mm[1]
    _, tears = run_rows(lambda x, s: -90.0 * ((x > high - 50) & (np.abs(s - 1200) < 100)), 1.6)
    assert {tear.kind for tear in tears} == {"torn right edge"}
    assert {finding.effect for finding in make_event_findings(tears, 20.0)} == {"none"}


def test_belt_that_runs_off_has_no_torn_edge():
    high = REFERENCE.belt.across_mm[1]
    _, tears = run_rows(lambda x, s: np.where((s > 500) & (x > high - 60), -400.0, 0 * x), 0.9)
    assert not tears


def ragged_edge(
    over: NDArray[np.float64],
    draw: np.random.Generator,
    share: float,
    *,
    fixed: bool,
    tear: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Take cells from the right edge, as coarse images do: at places of the view, and by chance in pairs of rows."""
    over = over.copy()
    if fixed:
        over[3:6, -3:] = np.nan
        over[19:23, -2:] = np.nan
    for row in np.flatnonzero(draw.random(len(over)) < share):
        over[row : row + 2, -int(draw.integers(2, 4)) :] = np.nan
    if tear is not None:
        over[tear, -3:] = np.nan
    return over


@pytest.mark.parametrize(
    ("fixed", "share", "step_mm"),
    [(True, 0.0, 100.0), (True, 0.05, 60.0), (False, 0.05, 90.0), (False, 0.1, 40.0)],
)
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in (1, 2))])
def test_an_edge_of_coarse_images_is_not_torn_but_a_tear_in_it_is(
    fixed: bool, share: float, step_mm: float, seed: int
):
    low, high = REFERENCE.belt.across_mm
    side = (high - low) / 32
    y = side * (np.arange(24, dtype=np.float64) - 11.5)
    for torn in (False, True):
        draw, events = np.random.default_rng(seed), list[BeltEvent]()
        passes = BeltPasses(side, None, 3000.0)
        for number in range(int(6000 / step_mm)):
            is_torn = np.abs(number * step_mm - y - 3000) < 120
            over = ragged_edge(np.zeros((24, 32)), draw, share, fixed=fixed, tear=is_torn if torn else None)
            rows = CellRows(y, over, np.full(over.shape, 0.1), np.isfinite(over), side)
            events += passes.add(rows, number * step_mm, 1)
        assert [one.kind for one in events] == ["torn right edge"] * torn
        assert [one.position_mm for one in events] == pytest.approx([3000.0] * torn, abs=60)


def test_a_load_is_no_carry_back():
    monitor, heap = BeltMonitor(REFERENCE), Heap(-1000.0, 4000.0, half_width_mm=150.0)
    for number in range(5):
        monitor.check(depth_map(heap, number * STEP_MM, seed=number))
        findings = {finding.check: finding for finding in monitor.follow(number * STEP_MM, 1)}
        assert np.isnan(findings["carry_back"].value)
        assert findings["carry_back_total"].value == 0.0


def thin_stream(x: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.floating]:
    """Fine material, 28 mm high and 100 mm wide, without a gap."""
    return np.clip(28.0 * (1 - (x / 50) ** 2), 0, None) * np.ones_like(s)


def single_stones(x: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.floating]:
    """Stones of 80 mm, 30 mm high, every 800 mm."""
    return np.sqrt(np.clip(1 - (x / 40) ** 2 - ((s % 800 - 400) / 40) ** 2, 0, None)) * 30.0


def small_heaps(x: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.floating]:
    """Low heaps, 12 mm high, with a real load between them every 2 m."""
    heap = 12.0 * ((np.abs(x) < 60) & (np.abs(s % 2000 - 500) < 150))
    return heap + 70.0 * ((np.abs(x) < 120) & (np.abs(s % 2000 - 1500) < 150))


@pytest.mark.parametrize("load", [thin_stream, single_stones, small_heaps])
def test_a_thin_load_is_no_carry_back(load: Surface):
    passes, events = run_rows(load, 2.0)
    assert passes.residue_mm3 == 0.0 and not passes.is_empty
    assert not events and make_beside_finding(passes.beside_load, 0.05, 500.0, BeltLimits()) is None
