"""Inverse-depth buffers and visibility: each level agrees with the reference; a step hides a known part."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from beltscape.kernels.reference.view import project
from tests.kernels.grids import STRAIGHT, WIDTHS, project_grid, surface, view_of_seed
from tests.kernels.rounding import emulated, first_alike
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", (*levels(), *emulated()))
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
widths = st.sampled_from(WIDTHS)


def near_a_border(view: np.ndarray, s: np.ndarray, half: float) -> np.ndarray:
    """(H, W) where a pixel is seen within 1e-3 px of what rounding parts."""
    u, v = project_grid(view, s)
    return np.minimum(*(np.abs(a - half - np.round(a - half)) for a in (u, v))) < 1e-3


@every_level
@given(seeds, widths, widths, st.integers(1, 50), st.integers(1, 50))
def test_native_buffers_agree_with_the_reference(level, seed, height, width, buffer_width, buffer_height):
    view, s = view_of_seed(seed), surface(seed, height, width)
    s[near_a_border(view, s, 0.0)] = np.nan
    sizes = [(buffer_width, buffer_height)]
    (expected,) = load("reference").inverse_depth_buffers(s, view[None], sizes)
    (found,) = load(level).inverse_depth_buffers(s, view[None], sizes)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@every_level
@given(seeds, widths, widths)
def test_native_visibility_agrees_with_the_reference(level, seed, height, width):
    view, s = view_of_seed(seed), surface(seed, height, width)
    (buffer,) = load(level).inverse_depth_buffers(s, view[None], [(48, 40)])
    expected = load("reference").visible(s, view, buffer, 0.5)
    found = load(level).visible(s, view, buffer, 0.5)
    assert found.dtype == np.uint8
    close = near_a_border(view, s, 0.5)
    for tolerance in (0.4999, 0.5001):  # nor where the tolerance itself decides
        close |= load("reference").visible(s, view, buffer, tolerance) != expected
    assert not found[np.isnan(s)].any()
    np.testing.assert_array_equal(found[~close], expected[~close])


@everything
@given(seeds, st.floats(0, 5))
def test_what_a_pixel_wrote_itself_never_hides_it(name, seed, tolerance):
    """The nearest pixel is one of the 2 × 2 written: alone, every point inside is visible."""
    kernels, view, s = load(name), view_of_seed(seed), np.full((1, 1), np.nan)
    s[0, 0] = 10.0
    (buffer,) = kernels.inverse_depth_buffers(s, view[None], [(48, 40)])
    seen = kernels.visible(s, view, buffer.astype(np.float32) * (1 - 1e-6), tolerance)
    u, v, _ = project(view, np.zeros(1), np.zeros(1), s[0])
    assert seen[0, 0] == bool(-0.5 <= u[0] < 47.5 and -0.5 <= v[0] < 39.5)


@everything
def test_a_near_step_hides_the_far_floor_beside_it(name):
    """Floor at s = 2 and a block at s = 7 on the left: seen from 7 px to the right, it covers 5 px of floor."""
    kernels, s = load(name), np.full((6, 40), 2.0)
    s[:, :10] = 7.0
    (buffer,) = kernels.inverse_depth_buffers(s, STRAIGHT[None], [(60, 6)])
    np.testing.assert_array_equal(buffer[3, :7], 0)
    np.testing.assert_array_equal(buffer[3, 7:18], 7)  # columns 7 … 16 and, as 2 × 2, one more
    np.testing.assert_array_equal(buffer[3, 18:43], 2)
    np.testing.assert_array_equal(buffer[3, 43:], 0)
    hidden = kernels.visible(s, STRAIGHT, buffer, 0.5)[3] == 0
    np.testing.assert_array_equal(np.flatnonzero(hidden), np.arange(10, 16))
    assert kernels.visible(s, STRAIGHT, buffer, 5.0).all()


@everything
def test_half_a_pixel_rounds_up_and_the_edges_are_half_pixels(name):
    s = np.array([[-0.5, -0.6, 2.5, 2.4, np.nan, np.inf]])
    view = STRAIGHT.copy()
    view[:3] = 0  # seen at pixel s, whatever u
    buffer = np.array([[0, 9, 9]], np.float32)
    with np.errstate(all="ignore"):
        seen = load(name).visible(s, view, buffer, 20.0)
        nearest = load(name).visible(s, view, buffer, 5.0)
    np.testing.assert_array_equal(seen[0], [1, 0, 0, 1, 0, 0])
    np.testing.assert_array_equal(nearest[0], [1, 0, 0, 0, 0, 0])


@everything
def test_several_views_are_filled_as_each_alone(name):
    kernels, s = load(name), surface(5, 30, 41)
    views = np.stack([view_of_seed(i) for i in range(4)])
    sizes = [(48, 40), (20, 10), (1, 1), (64, 64)]
    together = kernels.inverse_depth_buffers(s, views, sizes)
    for view, size, buffer in zip(views, sizes, together, strict=True):
        (alone,) = kernels.inverse_depth_buffers(s, view[None], [size])
        np.testing.assert_array_equal(buffer, alone)
        assert buffer.shape == size[::-1]
    assert kernels.inverse_depth_buffers(s, views[:0], []) == []


def results(level: str, threads: int) -> list[bytes]:
    kernels, s = load(level), surface(7, 99, 77)
    views = np.stack([view_of_seed(i, 77, 99) for i in range(3)])
    buffers = kernels.inverse_depth_buffers(s, views, [(77, 99)] * 3, threads=threads)
    seen = kernels.visible(s, views[0], buffers[0], 0.3, threads=threads)
    assert 0.2 < seen.mean() < 0.95
    return [array.tobytes() for array in (*buffers, seen)]


@every_level
@pytest.mark.parametrize("threads", [0, 2, 5])
def test_neither_threads_nor_levels_change_a_byte(level, threads):
    assert results(level, threads) == results(first_alike(level), 1)


@everything
def test_wrong_shapes_are_named(name):
    kernels, grid = load(name), np.ones((5, 6))
    for call, message in (
        (
            lambda: kernels.inverse_depth_buffers(grid, STRAIGHT[None], [(4, 4), (5, 5)]),
            "views must have the shape (2, 39), not (1, 39)",
        ),
        (
            lambda: kernels.inverse_depth_buffers(grid, STRAIGHT[None], [(4, 0)]),
            "an image's size must be positive, not (4, 0)",
        ),
        (
            lambda: kernels.inverse_depth_buffers(grid[0], STRAIGHT[None], [(4, 4)]),
            "s must have the shape (H, W), not (6,)",
        ),
        (
            lambda: kernels.visible(grid, STRAIGHT[None], grid, 1.0),
            "view must have the shape (39,), not (1, 39)",
        ),
        (
            lambda: kernels.visible(grid, STRAIGHT, grid[0], 1.0),
            "buffer must have the shape (h, w), not (6,)",
        ),
    ):
        with pytest.raises(KernelError) as error:
            call()
        assert str(error.value) == message
