"""The load of one frame: pixels of low confidence do not become load."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.measure.flow.meter import BeltFlowMeter
from beltscape.measure.flow.strips import FlowTotals
from tests.measure.flow.moving_belt import Heap, depth_map, make_empty_belt

HEAP = Heap(start_mm=-900, end_mm=-300)
FALSE_MM = 25.0


def with_bridges(depth: DepthMap, confidence: float, seed: int) -> DepthMap:
    """Blocks of false surface over a twelfth of the image, above the true one, trusted so far."""
    rng = np.random.default_rng(seed)
    false = np.kron(rng.random((25, 30)) < 1 / 12, np.ones((6, 6))) > 0
    return replace(
        depth,
        depth_mm=np.where(false, depth.depth_mm - FALSE_MM, depth.depth_mm).astype(np.float32),
        confidence=np.where(false, confidence, 0.99).astype(np.float32),
    )


def measure_totals(confidence: float) -> FlowTotals:
    meter = BeltFlowMeter(make_empty_belt())
    for k, place in enumerate(np.arange(0.0, 1300.0, 130.0)):
        depth = with_bridges(depth_map(HEAP, place), confidence, k)
        meter.push(depth, round(k * 1e8), place)
    meter.finish()
    return meter.totals


def test_doubtful_bridges_do_not_raise_the_total() -> None:
    assert measure_totals(0.68).volume_mm3 == pytest.approx(HEAP.volume_mm3, rel=0.01)


def test_bridges_that_may_be_false_enter_the_sigma_of_a_total() -> None:
    trusted, doubtful = measure_totals(0.99), measure_totals(0.75)
    added = np.sqrt(doubtful.sigma_mm3**2 - trusted.sigma_mm3**2)
    left, right = make_empty_belt().belt.across_mm
    expected = 0.5 * 0.25 * FALSE_MM / 12 * (right - left) * doubtful.length_mm
    assert added == pytest.approx(expected, rel=0.35)  # σ of their cells changes, too


def test_a_frame_without_a_trusted_pixel_measures_nothing() -> None:
    depth = depth_map(HEAP, 500.0)
    doubtful = replace(depth, confidence=np.full(depth.depth_mm.shape, 0.6, np.float32))
    assert not np.isfinite(make_empty_belt().measure_load(doubtful).height_mm).any()
    assert np.isfinite(make_empty_belt().measure_load(depth).height_mm).mean() > 0.9
