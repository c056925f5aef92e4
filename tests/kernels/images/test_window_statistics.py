"""Lines and windows over a grid: each level against the reference to the bit, and what they must say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.arrays import CellIndices
from beltscape.kernels.native import levels
from tests.kernels.grids import WIDTHS
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", levels())
everything = pytest.mark.parametrize("name", ["reference", *levels()])
lengths = st.sampled_from(WIDTHS)
sides = st.lists(st.sampled_from([1, 3, 5, 7, 9, 15, 17, 33, 51, 131]), min_size=1, max_size=4).map(tuple)
shares = st.sampled_from([0.0, 0.02, 0.5, 0.9, 1.0])
counts = st.sampled_from([0, 1, 5, 40])


def a_field(seed: int, height: int, width: int, holes: float) -> np.ndarray:
    """Heights about 0 on a slope, and a share of what is not finite."""
    rng = np.random.default_rng(seed)
    field = rng.normal(size=(height, width)) + rng.normal() * np.arange(width)
    field[rng.random(field.shape) < holes] = rng.choice([np.nan, np.nan, np.inf, -np.inf])
    return field


def places(seed: int, shape: tuple[int, ...], count: int) -> CellIndices:
    """Anywhere, in no order, corners among them."""
    rng = np.random.default_rng(seed)
    corners = [[0, 0], [shape[0] - 1, 0], [0, shape[1] - 1], [shape[0] - 1, shape[1] - 1]]
    found = np.concatenate([np.array(corners)[: count // 2], rng.integers(0, shape, (count, 2))])[:count]
    rows, columns = rng.permutation(found).T
    return rows, columns


def assert_same(found: tuple[np.ndarray, ...], expected: tuple[np.ndarray, ...]) -> None:
    for a, b in zip(found, expected, strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)


@every_level
@given(
    seeds, st.tuples(lengths, lengths), shares, counts, st.integers(1, 6), st.booleans(), st.integers(0, 60)
)
def test_lines_are_the_references(level, seed, size, holes, count, ways, fixed, most):
    rng = np.random.default_rng(seed)
    measured = rng.random(size) >= holes
    shape = (ways, 1 if fixed else count)
    turn = rng.uniform(0, 2 * np.pi, shape)
    # halves step onto borders between cells
    half = rng.random(shape) < 0.5
    down, across = (np.where(half, np.round(2 * part) / 2, part) for part in (np.sin(turn), np.cos(turn)))
    given = measured, places(seed, measured.shape, count), down, across, most
    assert_same(load(level).first_hits(*given, threads=2), load("reference").first_hits(*given))


@every_level
@given(seeds, lengths, lengths, shares, counts, sides)
def test_windows_are_the_references(level, seed, height, width, holes, count, of):
    field = a_field(seed, height, width, holes)
    native, reference, place = load(level), load("reference"), places(seed, field.shape, count)
    given = field, place, of
    assert_same(native.quadratics(*given, threads=2), reference.quadratics(*given))
    assert_same(native.window_means(*given, threads=2), reference.window_means(*given))
    assert_same((native.window_minima(*given),), (reference.window_minima(*given),))
    # SciPy is free to add up in another order
    np.testing.assert_allclose(
        native.plane_slopes(field, threads=2), reference.plane_slopes(field), rtol=1e-9, atol=1e-9
    )


@every_level
def test_a_tall_field_is_cut_into_the_references_bands(level):
    field = a_field(3, 700, 9, 0.3)
    place = places(3, field.shape, 90)
    place = (np.where(place[0] < 300, place[0], 650 + place[0] % 50), place[1])
    native, reference = load(level), load("reference")
    given = field, place, (9, 25)
    assert_same(native.quadratics(*given), reference.quadratics(*given))
    assert_same(native.window_means(*given), reference.window_means(*given))
    assert_same((native.window_minima(*given),), (reference.window_minima(*given),))


def results(level: str, threads: int) -> list[bytes]:
    kernels, field = load(level), a_field(5, 300, 61, 0.6)
    place = np.nonzero(~np.isfinite(field))
    turn = np.linspace(0, 6, 9)[:, None]
    told = (
        *kernels.first_hits(np.isfinite(field), place, np.sin(turn), np.cos(turn), 90, threads=threads),
        *kernels.quadratics(field, place, (9, 25), threads=threads),
        *kernels.window_means(field, place, (9, 25), threads=threads),
        kernels.window_minima(field, place, (9, 25), threads=threads),
        kernels.plane_slopes(field, threads=threads),
    )
    return [array.tobytes() for array in told]


@every_level
@pytest.mark.parametrize("threads", [0, 2, 5])
def test_neither_threads_nor_levels_change_a_byte(level, threads):
    assert results(level, threads) == results(levels()[0], 1)


@everything
def test_a_line_ends_at_the_first_measured_cell_or_nowhere(name):
    measured = np.zeros((9, 12), bool)
    measured[2, 9] = measured[7, 4] = measured[4, 4] = True
    place = (np.array([2, 4]), np.array([4, 4]))
    down, across = np.array([[0.0], [1.0], [0.5], [0.0]]), np.array([[1.0], [0.0], [0.0], [0.0]])
    cell, steps = load(name).first_hits(measured, place, down, across, 20)
    inf = np.inf
    # halves go to even rows: 2, 3, 4, and 4, 5, 6, 6, 6, 7
    np.testing.assert_array_equal(steps, [[5, inf], [2, 3], [3, 1], [inf, 1]])
    np.testing.assert_array_equal(cell, [[2 * 12 + 9, -1], [52, 88], [52, 52], [-1, 52]])
    short = load(name).first_hits(measured, place, down, across, 2)
    np.testing.assert_array_equal(short.steps, [[inf, inf], [2, inf], [inf, 1], [inf, 1]])


@everything
@given(seed=seeds)
def test_a_mirrored_field_has_mirrored_lines_and_slopes(name, seed):
    field = a_field(seed, 19, 23, 0.5)
    place, turn = places(seed, field.shape, 9), np.random.default_rng(seed).uniform(0, 7, (4, 1))
    turned = (place[0], 22 - place[1])
    measured, ways = np.isfinite(field), (np.sin(turn), np.cos(turn))
    one = load(name).first_hits(measured, place, *ways, 30)
    other = load(name).first_hits(measured[:, ::-1], turned, ways[0], -ways[1], 30)
    np.testing.assert_array_equal(other.steps, one.steps)
    across, down = load(name).plane_slopes(field)
    other_across, other_down = load(name).plane_slopes(field[:, ::-1])
    np.testing.assert_allclose(other_across[:, ::-1], -across, atol=1e-9)
    np.testing.assert_allclose(other_down[:, ::-1], down, atol=1e-9)


@everything
def test_a_plane_has_its_slopes_wherever_it_was_measured(name):
    y, x = np.mgrid[:20, :30].astype(float)
    field = 0.3 * x - 0.7 * y
    field[np.random.default_rng(0).random(field.shape) < 0.3] = np.nan
    slope = load(name).plane_slopes(field)
    known = np.isfinite(field)
    np.testing.assert_allclose(slope[:, known], np.tile([[0.3], [-0.7]], known.sum()), atol=1e-9)
    assert (slope[:, ~known] == 0).all()
    lone = np.where((y == 3) | ((x == 20) & (y == 15)), field, np.nan)
    assert (load(name).plane_slopes(lone) == 0).all()


@everything
def test_means_and_minima_are_those_of_the_windows_and_nothing_of_empty_ones(name):
    field = np.full((40, 40), np.nan)
    field[20, 20], field[21, 22], field[0, 0] = 4.0, -2.0, 7.0
    place = (np.array([20, 21, 35, 0]), np.array([20, 21, 35, 1]))
    share, mean = load(name).window_means(field, place, (3, 5))
    nothing = np.nan
    # beyond its corner the field's border goes on
    np.testing.assert_allclose(share, [[1 / 9, 2 / 9, 0, 2 / 9], [2 / 25, 2 / 25, 0, 6 / 25]])
    np.testing.assert_allclose(mean, [[4, 1, nothing, 7], [1, 1, nothing, 7]])
    least = load(name).window_minima(field, place, (5, 3))
    np.testing.assert_array_equal(least, [[-2, -2, nothing, 7], [4, -2, nothing, 7]])


FITS = {"field": np.ones((5, 6)), "cells": (np.array([1]), np.array([2])), "sides": (3,)}
LINES = {
    "measured": np.ones((5, 6), bool), "cells": (np.array([1, 4]), np.array([2, 5])),
    "down": np.ones((3, 1)), "across": np.ones((3, 1)), "most": 4,
}  # fmt: skip


@everything
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"field": np.ones(6)}, "field must have the shape (Ny, Nx), not (6,)"),
        ({"sides": (3, 4)}, "sides must be odd and positive, not (3, 4)"),
        ({"sides": ()}, "sides must be odd and positive, not ()"),
        (
            {"cells": (np.zeros(2), np.zeros(3))},
            "cells must have the shapes (H,) and (H,), not (2,) and (3,)",
        ),
        ({"cells": (np.array([5]), np.array([0]))}, "cells must lie within the field (5, 6)"),
        ({"cells": (np.array([0]), np.array([-1]))}, "cells must lie within the field (5, 6)"),
    ],
)
def test_windows_that_do_not_fit_are_named(name, wrong, message):
    kernels = load(name)
    for kernel in (kernels.quadratics, kernels.window_means, kernels.window_minima):
        with pytest.raises(KernelError) as error:
            kernel(**(FITS | wrong))
        assert str(error.value) == message


@everything
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"measured": np.ones((0, 4), bool)}, "measured must have the shape (Ny, Nx), not (0, 4)"),
        ({"down": np.ones((3, 3))}, "down must have the shape (D, 1) or (D, 2), not (3, 3)"),
        ({"across": np.ones((2, 1))}, "across must have the shape (D, 1) or (D, 2), not (2, 1)"),
        ({"across": np.full((3, 1), 1.5)}, "across must be -1 to 1"),
        ({"down": np.full((3, 1), np.nan)}, "down must be -1 to 1"),
        ({"most": -1}, "most must be at least 0, not -1"),
    ],
)
def test_lines_that_do_not_fit_are_named(name, wrong, message):
    with pytest.raises(KernelError) as error:
        load(name).first_hits(**(LINES | wrong))
    assert str(error.value) == message
    with pytest.raises(KernelError, match="field must have"):
        load(name).plane_slopes(np.ones(3))
