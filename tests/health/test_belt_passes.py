"""What is stuck to the belt, and marks of the belt itself, over several revolutions of a small belt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.core.findings import Finding
from beltscape.health.belt.monitor import BeltMonitor
from beltscape.health.belt.settings import BeltLimits
from tests.measure.flow.moving_belt import CAMERA, Heap, depth_map, make_empty_belt

LENGTH_MM, STEP_MM = 4000.0, 110.0
Surface = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.floating]]
"""Height on the belt at x and the belt coordinate s."""
REFERENCE = make_empty_belt()
RAYS = CAMERA.rays()


def run_belt(surface: Surface, revolutions: float, *, scrape_after_mm: float = np.inf) -> list[Finding]:
    """All findings of a belt that runs so far; after ``scrape_after_mm`` it is clean."""
    monitor = BeltMonitor(REFERENCE, BeltLimits(belt_length_m=LENGTH_MM / 1000))
    out: list[Finding] = []
    for number in range(int(revolutions * LENGTH_MM / STEP_MM)):
        position = number * STEP_MM
        empty = depth_map(None, 0.0, seed=number)
        x, y = RAYS[..., 0] * empty.depth_mm, -RAYS[..., 1] * empty.depth_mm
        s = position - y
        layer = np.where(s < scrape_after_mm, surface(x, s % LENGTH_MM), 0.0)
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
    findings = run_belt(lambda x, _: 0 * x, 1.2)
    assert not any(finding.is_fault for finding in findings)
    assert not {"splice", "torn_edge_left", "torn_edge_right"} & {finding.check for finding in findings}
    assert last(findings, "carry_back_total") < 0.02


def test_carry_back_has_its_own_total_and_is_no_rise():
    findings = run_belt(cake, 2.0)
    assert last(findings, "carry_back_total") == pytest.approx(2 * CAKE_L, rel=0.15)
    assert last(findings, "carry_back_stuck") == pytest.approx(CAKE_L, rel=0.3)
    shifts = [finding for finding in findings if finding.check == "zero_shift"]
    assert not any(shift.is_fault for shift in shifts)
    assert max(abs(shift.value) for shift in shifts) < 0.1
    assert any(finding.is_fault for finding in findings if finding.check == "carry_back")


def test_spillage_that_does_not_return_is_not_stuck():
    findings = run_belt(cake, 2.0, scrape_after_mm=LENGTH_MM - 500)
    assert last(findings, "carry_back_total") == pytest.approx(CAKE_L, rel=0.15)
    assert last(findings, "carry_back_stuck") < 0.1 * CAKE_L


def test_splice_is_recognised_with_its_position():
    findings = run_belt(lambda _, s: 2.0 * (np.abs(s - 2300) < 60), 2.0)
    places = [finding.value for finding in findings if finding.check == "splice"]
    np.testing.assert_allclose(places, [2.3, 2.3], atol=0.04)
    assert not any(finding.is_fault for finding in findings if finding.check.startswith("zero"))


def test_torn_edge_is_recognised_with_its_position():
    high = REFERENCE.belt.across_mm[1]
    torn = run_belt(lambda x, s: -400.0 * ((x > high - 50) & (np.abs(s - 1200) < 100)), 1.6)
    tears = [finding for finding in torn if finding.check == "torn_edge_right"]
    np.testing.assert_allclose([tear.value for tear in tears], [1.2, 1.2][: len(tears)], atol=0.06)
    assert tears
    assert tears[0].is_fault
    assert not [finding for finding in torn if finding.check == "torn_edge_left"]


def test_a_load_is_no_carry_back():
    monitor, heap = BeltMonitor(REFERENCE), Heap(-1000.0, 4000.0, half_width_mm=150.0)
    for number in range(10):
        monitor.check(depth_map(heap, number * STEP_MM, seed=number))
        findings = {finding.check: finding for finding in monitor.follow(number * STEP_MM, 1)}
        assert np.isnan(findings["carry_back"].value)
        assert findings["carry_back_total"].value == 0.0
