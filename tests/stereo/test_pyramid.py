"""The coarse-to-fine pyramid: each grid starts from the surface of the coarser one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.stereo import settings as multiview_settings
from beltscape.stereo.multiview import pyramid
from beltscape.stereo.multiview.frame import halve_frame
from beltscape.stereo.multiview.pyramid import PyramidSolver, _compute_changed_share
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.surface import Surface, double_surface
from beltscape.stereo.settings import MultiviewSettings
from tests.stereo.scenes import (
    DEPTH_MM,
    make_ring,
    make_scene,
    mask_away_from_steps,
    mask_inner,
    patch,
    plane,
    prepare_scene,
    quantise,
    render_images,
)
from tests.strategies import seeds

STEP = plane(), patch(DEPTH_MM - 60, (-25, 25))
SETTINGS = MultiviewSettings(threads=1)
RANGE = (600.0, 780.0)


@pytest.fixture
def two_grids(monkeypatch):
    """Allow small images a coarser grid."""
    monkeypatch.setattr(multiview_settings, "_LEAST_WIDTH_PX", 60)


def make_solver(on_step=lambda: None) -> PyramidSolver:
    return PyramidSolver(RANGE, SETTINGS, on_step)


@given(seeds, st.integers(1, 9), st.integers(1, 9), st.booleans(), st.booleans())
def test_doubled_plane_is_the_same_plane(seed, height, width, odd_rows, odd_columns):
    s0, u0, v0 = np.random.default_rng(seed).normal(0, [50, 0.5, 0.5])
    v, u = np.mgrid[:height, :width]
    coarse = Surface(
        (s0 + u0 * u + v0 * v).astype(np.float32),
        np.full((height, width), u0, np.float32),
        np.full((height, width), v0, np.float32),
    )
    fine = double_surface(coarse, (2 * height + odd_rows, 2 * width + odd_columns))
    assert fine.s.shape == fine.slope_u.shape == (2 * height + odd_rows, 2 * width + odd_columns)
    v, u = (np.mgrid[: 2 * height, : 2 * width] - 0.5) / 2
    np.testing.assert_allclose(
        fine.s[: 2 * height, : 2 * width], 2 * (s0 + u0 * u + v0 * v), rtol=1e-4, atol=1e-4
    )
    np.testing.assert_array_equal(fine.slope_u, np.float32(u0))
    assert fine.s[-1].tobytes() == fine.s[2 * height - 1].tobytes()


@pytest.mark.parametrize("size_px", [(120, 100), (121, 99)])
def test_a_halved_frame_equals_the_frame_prepared_in_blocks(size_px):
    made = make_scene(*STEP, rig=make_ring(size_px=size_px), noise=1.0)
    half = halve_frame(made.prepared)
    images = {
        name: quantise(image, np.uint16) for name, image in render_images(made.rig, STEP, noise=1.0).items()
    }
    whole = prepare_scene(made.rig, FrameSet("000", images), step=2)
    assert half.core.shape == whole.core.shape
    assert half.views.tobytes() == whole.views.tobytes()
    for one, other in zip(
        (*half.images, *half.coefficients), (*whole.images, *whole.coefficients), strict=True
    ):
        np.testing.assert_allclose(one, other, atol=0.01)
    within = mask_inner(half.core.shape, 2)
    assert np.nanmean(np.abs(half.core - whole.core)[within]) < 0.06 * np.nanstd(whole.core)
    assert half.noise.texture == pytest.approx(whole.noise.texture, rel=0.15)


def test_a_block_with_a_missing_pixel_is_missing():
    made = make_scene(plane())
    core = made.prepared.core.copy()
    core[10:13, 20] = np.nan
    half = halve_frame(replace(made.prepared, core=core))
    missing = np.zeros(half.core.shape, bool)
    missing[5:7, 10] = True
    np.testing.assert_array_equal(
        np.isnan(half.core), missing | np.isnan(half.core) & ~mask_inner(half.core.shape, 2)
    )


@pytest.mark.usefixtures("two_grids")
def test_step_is_solved_from_a_coarser_grid():
    made = make_scene(*STEP, rig=make_ring(size_px=(160, 120)), noise=1.0)
    steps = []
    surface, prepared = make_solver(lambda: steps.append(1)).initialise(made.prepared)
    assert len(steps) == 2  # the sweep, and the coarse grid
    assert prepared.noise != made.prepared.noise
    _, solution = make_solver().propagate(surface, prepared)
    off = np.abs(solution.surface.s - made.s)[mask_inner(made.s.shape, 8)]
    assert (off < 1).mean() > 0.99
    smooth = mask_away_from_steps(made.s, 6) & mask_inner(made.s.shape, 8)
    assert np.median(np.abs(solution.surface.s - made.s)[smooth]) < 0.03
    assert np.median(np.abs(surface.s - made.s)[smooth]) < 0.1


@pytest.mark.usefixtures("two_grids")
def test_every_grid_is_reported():
    made = make_scene(*STEP, rig=make_ring(size_px=(160, 120)), noise=1.0)
    images = {name: quantise(image) for name, image in render_images(made.rig, STEP, noise=1.0).items()}
    steps = []

    class Steps(Silent):
        def step(self, stage: str, done: int, total: int) -> None:
            steps.append((done, total))

    MultiviewReconstructor(made.rig, RANGE, SETTINGS).reconstruct(FrameSet("000", images), Steps())
    assert steps == [(i, 5) for i in range(1, 6)]


def test_rounds_end_when_hardly_a_pixel_changes(monkeypatch):
    made = make_scene(plane())
    rounds = []
    once = pyramid.propagate
    monkeypatch.setattr(pyramid, "propagate", lambda *given: rounds.append(1) or once(*given))
    flat = np.zeros_like(made.s)
    make_solver().propagate(Surface(made.s, flat, flat), made.prepared)
    assert len(rounds) == 1
    rough = np.where(np.random.default_rng(1).random(made.s.shape) < 0.2, made.s + 6, made.s).astype(
        np.float32
    )
    make_solver().propagate(Surface(rough, flat, flat), made.prepared)
    assert len(rounds) == 3


def test_the_share_of_changed_pixels_is_counted():
    s = np.zeros((10, 10), np.float32)
    other = s.copy()
    other[0, :5], other[1] = 0.6, 0.4
    assert _compute_changed_share(Surface(s, s, s), Surface(other, s, s)) == pytest.approx(0.05)
