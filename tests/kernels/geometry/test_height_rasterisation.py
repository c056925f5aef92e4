"""Height rasterisation: each level equals the reference to the bit; planes and layers have known heights."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.geometry import RasterisedHeights
from beltscape.kernels.native import levels
from tests.kernels.grids import WIDTHS, surface
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", levels())
everything = pytest.mark.parametrize("name", ["reference", *levels()])
widths = st.sampled_from(WIDTHS[:-2])
nodes = st.integers(1, 12)


def above(
    name: str, depth: np.ndarray, matrix: list[list[float]] | np.ndarray, step: float, shape, **given
) -> RasterisedHeights:
    """The view with σ = 1 and every pixel in use, where nothing else is given."""
    sigma, use = given.get("sigma", np.ones(depth.shape)), given.get("use", np.ones(depth.shape, bool))
    return load(name).rasterise_heights(depth, sigma, use, np.array(matrix, float), step, shape)


def transform(seed: int, kind: str, mesh: tuple[int, int], grid: tuple[int, int]) -> np.ndarray:
    """(3, 4) that lays a mesh of depth 10 over a grid: anyhow, on its nodes, in folds, or squeezed to a line."""
    rng = np.random.default_rng(seed)
    turn, scale = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 2.5) / 10
    matrix = rng.normal(size=(3, 4)) * [0.02, 0.02, 3 if kind == "folded" else 0.3, 0]
    matrix[:2, :2] += scale * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    if kind == "line":
        matrix[1] = matrix[0]
    if kind == "whole":
        matrix[:, :3] = np.round(matrix[:, :3] * 10)
    middle = np.array([mesh[1] // 2, mesh[0] // 2, 1]) * (1 if kind == "whole" else 10)
    matrix[:2, 3] = [grid[1] // 2, grid[0] // 2] - matrix[:2, :3] @ middle
    return matrix


@every_level
@given(
    seeds, widths, widths, nodes, nodes, st.sampled_from(["any", "whole", "line", "folded"]), st.floats(0, 6)
)
def test_native_is_the_reference_to_the_bit(level, seed, height, width, rows, columns, kind, step):
    rng, shape = np.random.default_rng(seed), (rows, columns)
    depth = surface(seed, height, width, 0.03)
    if kind == "whole":
        depth = np.round(depth / 10)
    sigma = rng.choice([0.5, 1.0, 3.0, np.nan, np.inf], depth.shape, p=[0.4, 0.3, 0.28, 0.01, 0.01])
    use = rng.random(depth.shape) < 0.97
    given = depth, sigma, use, transform(seed, kind, depth.shape, shape), step, shape
    expected, found = load("reference").rasterise_heights(*given), load(level).rasterise_heights(*given)
    for a, b in zip(found, expected, strict=True):
        assert a.dtype == np.float64
        np.testing.assert_array_equal(a, b)
        assert a.tobytes() == b.tobytes()
    assert (np.isfinite(found.height) == np.isfinite(found.variance)).all()


@everything
@given(
    slope=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    shift=st.tuples(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9)),
    scale=st.floats(0.4, 2.5),
)
def test_a_plane_is_reproduced_exactly_wherever_its_points_lie(name, slope, shift, scale):
    matrix = np.zeros((3, 4))
    matrix[0, [0, 3]], matrix[1, [1, 3]] = (scale, shift[0]), (scale, shift[1])
    matrix[2] = slope @ matrix[:2]
    top, variance = above(name, np.ones((12, 14)), matrix, 0.0, (9, 10))
    y, x = np.mgrid[:9, :10].astype(float)
    low, high = np.array(shift), np.array([13, 11]) * scale + shift
    margin = np.minimum(np.minimum(x - low[0], high[0] - x), np.minimum(y - low[1], high[1] - y))
    met = np.isfinite(top)
    assert met[margin > 1e-6].all()
    assert not met[margin < -1e-6].any()
    np.testing.assert_allclose(top[met], (x * slope[0] + y * slope[1])[met], atol=1e-7)
    np.testing.assert_allclose(variance[met], 1, atol=1e-12)


FOUR_NODES_A_PIXEL = [[4e-3, 0, 0, 0], [0, 4e-3, 0, 0], [1, 0, 0, 0]]
"""For depths of about 1000."""


@everything
def test_a_step_cuts_the_mesh(name):
    depth = np.full((4, 6), 1000.0)
    depth[:, 3:] = 1001.0
    joined = above(name, depth, FOUR_NODES_A_PIXEL, 1.0, (13, 21))  # pyrefly: ignore[bad-argument-type]
    cut = above(name, depth, FOUR_NODES_A_PIXEL, 0.9, (13, 21))  # pyrefly: ignore[bad-argument-type]
    assert np.isfinite(joined.height).all()
    assert np.isnan(cut.height[1:, 9:13]).all()
    assert np.isfinite(cut.height[1:, [8, 13]]).all()


@everything
@pytest.mark.parametrize(
    ("out", "left"),
    [((0, 0), lambda u, v: u + v >= 4), ((1, 1), lambda u, v: u + v <= 4),
     ((0, 1), lambda u, v: v >= u), ((1, 0), lambda u, v: v <= u)],
)  # fmt: skip
def test_a_square_that_lacks_a_corner_is_a_triangle(name, out, left):
    depth, use = np.full((2, 2), 1000.0), np.ones((2, 2), bool)
    use[out] = False
    v, u = np.indices((5, 5))
    here = above(name, depth, FOUR_NODES_A_PIXEL, 0.0, (5, 5), use=use)  # pyrefly: ignore[bad-argument-type]
    np.testing.assert_array_equal(np.isfinite(here.height), left(u, v))
    sigma = np.where(use, 1.0, np.nan)
    there = above(name, depth, FOUR_NODES_A_PIXEL, 0.0, (5, 5), sigma=sigma)  # pyrefly: ignore[bad-argument-type]
    np.testing.assert_array_equal(there.height, here.height)


def two_layers(turned: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(3, 20) depths and σ of a floor over columns 0 … 9 and of what hangs over its columns 5 … 9, and a transform.

    The floor's pixels come first, or last where they are ``turned``.
    """
    near = np.broadcast_to(np.arange(20) >= 10, (3, 20))[:, :: -1 if turned else 1]
    across = [-0.01, 0, 0.19, 0] if turned else [0.01, 0, 0, 0]
    matrix = np.array([across, [0, 0.01, 0, 0], [0, 0, -1, 100]])
    return np.where(near, 50.0, 100.0), np.where(near, 2.0, 1.0), matrix


both_ways = pytest.mark.parametrize("turned", [False, True])


@everything
@both_ways
@pytest.mark.parametrize("step", [1.0, 60.0])
def test_of_two_layers_the_upper_one_counts(name, turned, step):
    depth, sigma, matrix = two_layers(turned)
    top = above(name, depth, matrix, step, (2, 10), sigma=sigma)
    np.testing.assert_allclose(top.height, [[0] * 5 + [50] * 5] * 2, atol=1e-9)
    np.testing.assert_allclose(top.variance, [[1] * 5 + [4] * 5] * 2)


@everything
@both_ways
def test_of_layers_of_one_height_the_largest_variance_counts(name, turned):
    depth, sigma, matrix = two_layers(turned)
    matrix[2] = 0, 0, 0, 7
    top = above(name, depth, matrix, 1.0, (2, 10), sigma=sigma)
    assert (top.height == 7).all()
    np.testing.assert_allclose(top.variance, [[1] * 5 + [4] * 5] * 2)


@everything
def test_what_is_upright_or_a_single_row_has_no_area(name):
    upright = np.array([[1, 0, 0, 0], [2, 0, 0, 0], [0, 1, 0, 0]])
    assert np.isnan(above(name, np.ones((6, 6)), upright, 1.0, (12, 12))).all()
    assert np.isnan(above(name, np.ones((1, 6)), FOUR_NODES_A_PIXEL, 1.0, (4, 4))).all()  # pyrefly: ignore[bad-argument-type]


def results(level: str, threads: int) -> list[bytes]:
    rng = np.random.default_rng(3)
    depth, use = surface(3, 99, 77), rng.random((99, 77)) < 0.95
    matrix = np.array([[0.09, 0.01, 0.2, 0], [0.01, 0.07, -0.1, 0], [0.1, 0.1, -1, 0]])
    sigma = rng.uniform(1, 2, depth.shape)
    top = load(level).rasterise_heights(depth, sigma, use, matrix, 1.0, (60, 70), threads=threads)
    assert 0.2 < np.isfinite(top.height).mean() < 1
    return [array.tobytes() for array in top]


@every_level
@pytest.mark.parametrize("threads", [0, 2, 5])
def test_neither_threads_nor_levels_change_a_byte(level, threads):
    assert results(level, threads) == results(levels()[0], 1)


@everything
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"depth": np.ones(6)}, "depth must have the shape (H, W), not (6,)"),
        ({"sigma": np.ones((6, 5))}, "sigma must have the shape (5, 6), not (6, 5)"),
        ({"use": np.ones((5, 5), bool)}, "use must have the shape (5, 6), not (5, 5)"),
        ({"grid_from_pixel": np.eye(3)}, "grid_from_pixel must have the shape (3, 4), not (3, 3)"),
        ({"step": -1.0}, "step must be at least 0, not -1.0"),
        ({"step": np.nan}, "step must be at least 0, not nan"),
        ({"shape": (0, 4)}, "the grid's shape must be positive, not (0, 4)"),
    ],
)
def test_what_does_not_fit_is_named(name, wrong, message):
    fits = {
        "depth": np.ones((5, 6)), "sigma": np.ones((5, 6)), "use": np.ones((5, 6), bool),
        "grid_from_pixel": np.eye(3, 4), "step": 1.0, "shape": (4, 4),
    }  # fmt: skip
    with pytest.raises(KernelError) as error:
        load(name).rasterise_heights(**(fits | wrong))
    assert str(error.value) == message
