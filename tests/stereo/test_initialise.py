"""The first inverse depths: a wide range is narrowed before the sweep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.stereo.multiview import pyramid
from beltscape.stereo.multiview.pyramid import SweepResolution, initialise_inverse_depth
from tests.stereo.scenes import Scene, make_ring, make_scene, mask_inner, patch, plane

RIG = make_ring(size_px=(360, 300))
SOLIDS = plane(740), patch(640, (-150, 60), (-120, 120))


def run_initialise(made: Scene, near_far_mm: tuple[float, float]) -> np.ndarray:
    near, far = near_far_mm
    s_range = 1 / (far * made.unit), 1 / (near * made.unit)
    return initialise_inverse_depth(made.prepared, s_range, SweepResolution(1, 1.0))


@pytest.fixture(scope="module")
def made() -> Scene:
    return make_scene(*SOLIDS, rig=RIG, noise=0.5)


@pytest.fixture
def swept(monkeypatch) -> list[tuple[float, float]]:
    """Ranges of the full sweeps, in their order."""
    ranges = []

    def spy(prepared, s_range, *more):
        ranges.append(s_range)
        return original(prepared, s_range, *more)

    original = pyramid.sweep_planes
    monkeypatch.setattr(pyramid, "sweep_planes", spy)
    return ranges


def test_wide_range_is_narrowed_without_loss(made, swept):
    narrow = run_initialise(made, (620.0, 780.0))
    wide = run_initialise(made, (150.0, 3000.0))
    inside = mask_inner(made.s.shape, 8)
    right = [(np.abs(s - made.s)[inside] < 1.5).mean() for s in (narrow, wide)]
    assert right[0] > 0.9
    assert right[1] > right[0] - 0.005
    full = 1 / (150 * made.unit) - 1 / (3000 * made.unit)
    far, near = swept[1]
    assert near - far < 0.2 * full
    assert far < made.s.min()
    assert made.s.max() < near


def test_frame_without_texture_is_swept_over_the_whole_range(swept):
    blank = make_scene(plane(740), rig=make_ring((0, 90), size_px=(180, 150)))
    images = tuple(np.full_like(image, 0.5) for image in blank.prepared.images)
    flat = replace(blank.prepared, core=np.full_like(blank.prepared.core, 0.5), images=images)
    run_initialise(replace(blank, prepared=flat), (150.0, 3000.0))
    assert swept == [(1 / (3000 * blank.unit), 1 / (150 * blank.unit))]
