"""Slopes of a surface, with its steps and holes, and its upsampling."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from beltscape.kernels import load
from beltscape.stereo.multiview.surface import Surface, fit_slopes, upsample_surface
from tests.strategies import seeds
from tests.thorough import examples

slopes = st.floats(-0.25, 0.25)
V, U = np.indices((30, 40)).astype(np.float32)


@examples(20)
@given(slopes, slopes, st.floats(5, 60))
def test_slopes_of_a_plane_are_exact_up_to_its_border(slope_u, slope_v, s0):
    s = (s0 + slope_u * U + slope_v * V).astype(np.float32)
    surface = fit_slopes(s, load(), 1)
    np.testing.assert_array_equal(surface.s, s)
    np.testing.assert_allclose(surface.slope_u, slope_u, atol=0.03)
    np.testing.assert_allclose(surface.slope_v, slope_v, atol=0.03)


def test_slopes_at_a_step_are_those_of_each_side():
    left = U < 18
    s = np.where(left, 40 + 0.2 * U, 30 - 0.1 * V).astype(np.float32)
    surface = fit_slopes(s, load(), 1)
    np.testing.assert_allclose(surface.slope_u, np.where(left, 0.2, 0), atol=0.03)
    np.testing.assert_allclose(surface.slope_v, np.where(left, 0, -0.1), atol=0.03)


def test_holes_have_no_slopes_and_change_none_around():
    s = (20 + 0.15 * U).astype(np.float32)
    hole = (np.hypot(U - 20, V - 15) < 4) | (np.random.default_rng(1).random(s.shape) < 0.1)
    surface = fit_slopes(np.where(hole, np.float32(np.nan), s), load(), 1)
    assert np.array_equal(np.isnan(surface.slope_u), hole)
    np.testing.assert_allclose(surface.slope_u[~hole], 0.15, atol=0.02)
    np.testing.assert_allclose(surface.slope_v[~hole], 0, atol=0.02)


@given(seeds, st.integers(1, 5), st.integers(1, 6), st.integers(1, 6))
def test_upsampled_blocks_are_planes_with_the_value_as_mean(seed, step, height, width):
    rng = np.random.default_rng(seed)
    surface = Surface(*rng.normal(0, 1, (3, height, width)).astype(np.float32))
    fine = upsample_surface(surface, step)
    assert fine.shape == (step * height, step * width)
    blocks = fine.reshape(height, step, width, step)
    np.testing.assert_allclose(blocks.mean(axis=(1, 3)), surface.s, atol=1e-5)
    if step > 1:
        rise = np.broadcast_to(surface.slope_u[:, None, :, None] / step, blocks[..., 1:].shape)
        np.testing.assert_allclose(np.diff(blocks, axis=3), rise, atol=1e-5)
