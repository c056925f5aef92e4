"""The first inverse depths: predicted pixels are kept, others swept over a narrowed range."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.stereo.multiview.initialisation import initialise
from beltscape.stereo.multiview.initialisation.initialise import SweepResolution, initialise_inverse_depth
from tests.stereo.scenes import Scene, make_ring, make_scene, mask_inner, patch, plane

RIG = make_ring(size_px=(360, 300))
SOLIDS = plane(740), patch(640, (-150, 60), (-120, 120))
NEAR_FAR_MM = 620.0, 780.0


def run_initialise(
    made: Scene, near_far_mm: tuple[float, float], predicted: np.ndarray | None = None
) -> np.ndarray:
    near, far = near_far_mm
    return initialise_inverse_depth(
        predicted,
        made.prepared,
        (1 / (far * made.unit), 1 / (near * made.unit)),
        SweepResolution(1, 1.0),
    )


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

    original = initialise.sweep_planes
    monkeypatch.setattr(initialise, "sweep_planes", spy)
    return ranges


def test_wide_range_is_narrowed_without_loss(made, swept):
    narrow = run_initialise(made, NEAR_FAR_MM)
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


def test_predicted_pixels_are_kept_and_not_swept(made, swept):
    predicted = made.s + np.float32(0.25)
    np.testing.assert_array_equal(run_initialise(made, (150.0, 3000.0), predicted), predicted)
    assert swept == []


def test_strip_that_came_into_view_is_swept_beyond_the_predicted_range(made, swept):
    """The near box is new and nearer than all predicted pixels."""
    predicted = made.s.copy()
    columns = np.flatnonzero((made.s > made.s.min() + 3).any(axis=0))
    new = slice(None), slice(0, int(columns.max()) + 10)
    predicted[new] = np.nan
    s = run_initialise(made, (150.0, 3000.0), predicted)
    measured = np.isfinite(predicted)
    np.testing.assert_array_equal(s[measured], predicted[measured])
    part = mask_inner(made.s.shape, 8) & ~measured
    assert (np.abs(s - made.s)[part] < 1.5).mean() > 0.88
    assert swept


def test_hole_is_swept_between_the_depths_around_it(made, swept):
    predicted = made.s.copy()
    hole = slice(200, 290), slice(230, 330)
    predicted[hole] = np.nan
    s = run_initialise(made, (150.0, 3000.0), predicted)
    assert (np.abs(s - made.s)[hole] < 1.5).mean() > 0.95
    ((far, near),) = swept
    assert near < made.s.max() * 1.1
    assert near - far < 0.2 * (1 / (150 * made.unit) - 1 / (3000 * made.unit))


def test_frame_without_texture_is_swept_over_the_whole_range(swept):
    blank = make_scene(plane(740), rig=RIG)
    flat = Scene(
        blank.rig,
        initialise.replace(
            blank.prepared,
            core=np.full_like(blank.prepared.core, 0.5),
            images=tuple(np.full_like(image, 0.5) for image in blank.prepared.images),
        ),
        blank.s,
        blank.unit,
    )
    run_initialise(flat, (150.0, 3000.0))
    assert swept == [(1 / (3000 * blank.unit), 1 / (150 * blank.unit))]
