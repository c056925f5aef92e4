"""Lumps of a simulated heap from its true depth: the upper bound of what matched depth gives."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.evaluate.lump_scores import score_lumps
from beltscape.measure.lumps.lumps import measure_lumps
from beltscape.measure.lumps.settings import LumpSettings
from beltscape.pipeline.simulation import read_scenario
from beltscape.simulate.core_truth import label_rocks, trace_core_view
from beltscape.simulate.scene_assembly import SimulatedScene


@pytest.fixture(scope="module")
def heap():
    """Score and lumps of a heap of a few large rocks, in 612 × 512 px."""
    values = {
        "seed": 905,
        "rig": {"scale": 0.25},
        "heap": {"rocks": 60, "sizes": {"smallest_mm": 30, "largest_mm": 110, "median_mm": 70}},
    }
    scene = SimulatedScene(read_scenario("belt_loaded", values))
    world, camera = scene.world_at(0), scene.station.rig.core_camera
    view = trace_core_view(world, scene.station)
    assert scene.heap is not None
    known = np.isfinite(view.depth_mm)
    sigma = np.where(known, 0.05, np.nan).astype(np.float32)
    depth = DepthMap(
        view.depth_mm.astype(np.float32), sigma, known.astype(np.uint8), known.astype(np.float32)
    )
    rock, rocks = label_rocks(view, world.solids, scene.heap), scene.heap.rocks
    found = measure_lumps(depth, camera, LumpSettings(oversize_mm=60))
    pixel_mm = float(np.nanmedian(view.depth_mm)) / float(camera.focal_px.mean())
    return found, score_lumps(found, rock, rocks.size_mm, rocks.volume_mm3, pixel_mm=pixel_mm)


def test_its_rocks_are_found(heap):
    _, score = heap
    assert score.rocks > 20
    assert score.recall > 0.9
    assert score.precision > 0.9
    assert score.iou > 0.85


def test_its_large_rocks_are_found_and_none_is_made_up(heap):
    found, score = heap
    assert score.rocks_over > 5
    assert score.recall_over > 0.9
    assert score.precision_over == 1
    assert found.oversize.alarm


def test_their_sizes_are_right(heap):
    _, score = heap
    assert score.sized > 10
    assert abs(score.size_bias) < 0.08
    assert score.size_error < 0.10
    assert 0.3 < score.sigma_ratio < 2
    assert score.d50_mm == pytest.approx(score.d50_top_mm, rel=0.15)
