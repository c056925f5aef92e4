"""Splines and warps: each level against the reference, the reference against SciPy and against its laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates, spline_filter

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from tests.kernels.grids import STRAIGHT, WIDTHS, project_grid, surface, texture, view_of_seed
from tests.kernels.rounding import emulated, first_alike
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", (*levels(), *emulated()))
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
widths = st.sampled_from(WIDTHS)


@everything
@given(widths, widths, seeds)
def test_coefficients_are_scipys(name, height, width, seed):
    image = np.random.default_rng(seed).uniform(0, 255, (height, width)).astype(np.float32)
    expected = spline_filter(image.astype(np.float64), 3, mode="mirror")
    found = load(name).spline_coefficients(image)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * 255 * 9)  # |c| <= 9 |image|


@everything
@given(seeds, st.integers(7, 30), st.integers(7, 30))
def test_values_and_slopes_are_scipys(name, seed, height, width):
    kernels = load(name)
    coefficients = kernels.spline_coefficients(texture(seed, height, width))
    s = np.random.default_rng(seed).uniform(-3, 3, (height, width)).astype(np.float32)
    value, _ = kernels.warp(s, STRAIGHT, coefficients)
    v, u = np.indices(s.shape) + np.stack([np.zeros_like(s), s]).astype(np.float64)
    inside = (u >= 1) & (u < width - 2) & (v >= 1) & (v < height - 2)
    np.testing.assert_array_equal(np.isfinite(value), inside)
    expected = map_coordinates(
        coefficients.astype(np.float64), [v, u], order=3, mode="mirror", prefilter=False
    )
    np.testing.assert_allclose(value[inside], expected[inside], atol=5e-4)


@everything
@given(seeds)
def test_at_whole_pixels_the_spline_is_the_image(name, seed):
    kernels, image = load(name), texture(seed, 12, 19)
    value, _ = kernels.warp(np.zeros_like(image), STRAIGHT, kernels.spline_coefficients(image))
    np.testing.assert_allclose(value[1:-2, 1:-2], image[1:-2, 1:-2], atol=5e-4)


@everything
@given(seeds, st.floats(-1, 1), st.floats(-1, 1))
def test_a_sloping_plane_has_its_slope(name, seed, by_u, by_v):
    """Far from the mirrored edges, whose fold dies out by 0.27 a pixel."""
    kernels = load(name)
    v, u = np.indices((60, 60))
    s = np.random.default_rng(seed).uniform(-2, 2, u.shape)
    value, slope = kernels.warp(s, STRAIGHT, kernels.spline_coefficients(by_u * u + by_v * v))
    inner = slice(22, -22)
    plane = by_u * (u + s) + by_v * v
    np.testing.assert_allclose(value[inner, inner], plane[inner, inner], atol=5e-4)
    np.testing.assert_allclose(slope[inner, inner], by_u, atol=5e-4)


@every_level
@given(seeds, widths, widths)
def test_native_warps_agree_with_the_reference(level, seed, height, width):
    """To 1e-4 px of movement; a pixel on the edge of the image may fall to either side."""
    view, s, coefficients = view_of_seed(seed), surface(seed, height, width), texture(seed, 40, 48)
    expected, expected_slope = load("reference").warp(s, view, coefficients)
    value, slope = load(level).warp(s, view, coefficients)
    assert value.dtype == slope.dtype == np.float32
    u, v = project_grid(view, s)
    at_edge = np.minimum.reduce([np.abs(u - 1), np.abs(u - 46), np.abs(v - 1), np.abs(v - 38)]) < 1e-3
    np.testing.assert_array_equal(np.isnan(value)[~at_edge], np.isnan(expected)[~at_edge])
    np.testing.assert_array_equal(slope[np.isnan(value)], 0)
    both = np.isfinite(value) & np.isfinite(expected)
    np.testing.assert_allclose(value[both], expected[both], atol=0.02)
    np.testing.assert_allclose(slope[both], expected_slope[both], atol=0.05)


@everything
def test_nothing_is_seen_behind_the_auxiliary(name):
    backwards = STRAIGHT * np.where(np.arange(39) < 9, -1, 1).astype(np.float32)
    value, slope = load(name).warp(np.zeros((8, 8)), backwards, np.ones((8, 8)))
    assert np.isnan(value).all()
    assert not slope.any()


@everything
@pytest.mark.parametrize("far", [1e9, -1e9, 3e38, np.inf, -np.inf, np.nan])
def test_the_smallest_inverse_depth_is_outside(name, far):
    with np.errstate(all="ignore"):
        value, slope = load(name).warp(np.full((3, 21), far), STRAIGHT, np.ones((4, 4)))
    assert np.isnan(value).all()
    assert not slope.any()


def results(level: str, threads: int) -> list[bytes]:
    kernels, image = load(level), texture(1, 301, 517)
    coefficients = kernels.spline_coefficients(image, threads=threads)
    s, view = surface(2, 99, 77), view_of_seed(3, 77, 99)
    value, slope = kernels.warp(s, view, texture(4, 99, 77), threads=threads)
    assert np.isfinite(value).mean() > 0.2
    return [array.tobytes() for array in (coefficients, value, slope)]


@every_level
@pytest.mark.parametrize("threads", [0, 2, 5])
def test_neither_threads_nor_levels_change_a_byte(level, threads):
    assert results(level, threads) == results(first_alike(level), 1)


@everything
def test_wrong_shapes_are_named(name):
    kernels, grid = load(name), np.ones((5, 6))
    for call, message in (
        (lambda: kernels.spline_coefficients(grid[0]), "image must have the shape (h, w), not (6,)"),
        (lambda: kernels.spline_coefficients(grid[:0]), "image must have the shape (h, w), not (0, 6)"),
        (lambda: kernels.warp(grid[0], STRAIGHT, grid), "s must have the shape (H, W), not (6,)"),
        (lambda: kernels.warp(grid, STRAIGHT[:20], grid), "view must have the shape (39,), not (20,)"),
        (
            lambda: kernels.warp(grid, STRAIGHT, grid[:3]),
            "coefficients must be of at least 4 × 4 pixels, not (3, 6)",
        ),
    ):
        with pytest.raises(KernelError) as error:
            call()
        assert str(error.value) == message
