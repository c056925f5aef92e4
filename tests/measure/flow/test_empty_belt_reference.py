"""The load of one frame: pixels of low confidence do not become load."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.measure.flow.meter import BeltFlowMeter
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


def total_mm3(confidence: float) -> float:
    meter = BeltFlowMeter(make_empty_belt())
    for k, place in enumerate(np.arange(0.0, 1300.0, 130.0)):
        depth = with_bridges(depth_map(HEAP, place), confidence, k)
        meter.push(depth, round(k * 1e8), place)
    meter.finish()
    return meter.totals.volume_mm3


def test_doubtful_bridges_do_not_raise_the_total() -> None:
    assert total_mm3(0.68) == pytest.approx(HEAP.volume_mm3, rel=0.01)


def test_a_frame_without_a_trusted_pixel_measures_nothing() -> None:
    depth = depth_map(HEAP, 500.0)
    doubtful = replace(depth, confidence=np.full(depth.depth_mm.shape, 0.6, np.float32))
    assert not np.isfinite(make_empty_belt().measure_load(doubtful).height_mm).any()
    assert np.isfinite(make_empty_belt().measure_load(depth).height_mm).mean() > 0.9
