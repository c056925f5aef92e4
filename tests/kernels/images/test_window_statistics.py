"""Statistics of windows: each level equals the reference to the bit, on fields with known results."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from tests.kernels.grids import WIDTHS, assert_identical, cells_in, height_field
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", levels())
everything = pytest.mark.parametrize("name", ["reference", *levels()])
lengths = st.sampled_from(WIDTHS)
sides = st.lists(st.sampled_from([1, 3, 5, 7, 9, 15, 17, 33, 51, 131]), min_size=1, max_size=4).map(tuple)
shares = st.sampled_from([0.0, 0.02, 0.5, 0.9, 1.0])
counts = st.sampled_from([0, 1, 5, 40])


@every_level
@given(seeds, lengths, lengths, shares, counts, sides)
def test_windows_are_the_references(level, seed, height, width, holes, count, of):
    field = height_field(seed, height, width, holes)
    native, reference, given_cells = load(level), load("reference"), cells_in(seed, field.shape, count)
    given = field, given_cells, of
    assert_identical(native.quadratics(*given, threads=2), reference.quadratics(*given))
    assert_identical(native.window_means(*given, threads=2), reference.window_means(*given))
    assert_identical((native.window_minima(*given),), (reference.window_minima(*given),))
    # SciPy is free to add up in another order
    np.testing.assert_allclose(
        native.plane_slopes(field, threads=2), reference.plane_slopes(field), rtol=1e-9, atol=1e-9
    )


@every_level
@given(seeds, lengths, lengths, shares, st.sampled_from([-np.inf, 0.0, 30.0]))
def test_bends_are_the_references(level, seed, height, width, holes, above):
    field = height_field(seed, height, width, holes)
    given = field, (1, 2, 4, 64), above
    assert_identical(load(level).bend_medians(*given, threads=2), load("reference").bend_medians(*given))


@everything
def test_a_ramp_has_no_bends_and_a_parabola_its_second_difference(name):
    along = np.arange(40.0)
    ramp, parabola = np.add.outer(3 * along, 2 * along), np.tile(along**2, (5, 1))
    ramp[3, 4] = np.nan
    assert load(name).bend_medians(ramp, [1, 8], -1.0).median == pytest.approx([0, 0], abs=1e-12)
    found = load(name).bend_medians(parabola, [4, 30], -1.0)
    assert found.count.tolist() == [5 * 32, 0]
    assert found.median[0] == pytest.approx(16)
    assert np.isnan(found.median[1])
    with pytest.raises(KernelError, match="halves must be at least 1"):
        load(name).bend_medians(parabola, [0], 0.0)


@every_level
def test_a_tall_field_is_cut_into_the_references_bands(level):
    field = height_field(3, 700, 9, 0.3)
    given_cells = cells_in(3, field.shape, 90)
    given_cells = (np.where(given_cells[0] < 300, given_cells[0], 650 + given_cells[0] % 50), given_cells[1])
    native, reference = load(level), load("reference")
    given = field, given_cells, (9, 25)
    assert_identical(native.quadratics(*given), reference.quadratics(*given))
    assert_identical(native.window_means(*given), reference.window_means(*given))
    assert_identical((native.window_minima(*given),), (reference.window_minima(*given),))


def results(level: str, threads: int) -> list[bytes]:
    kernels, field = load(level), height_field(5, 300, 61, 0.6)
    given_cells = np.nonzero(~np.isfinite(field))
    arrays = (
        *kernels.quadratics(field, given_cells, (9, 25), threads=threads),
        *kernels.window_means(field, given_cells, (9, 25), threads=threads),
        kernels.window_minima(field, given_cells, (9, 25), threads=threads),
        kernels.plane_slopes(field, threads=threads),
    )
    return [array.tobytes() for array in arrays]


@every_level
@pytest.mark.parametrize("threads", [0, 2, 5])
def test_neither_threads_nor_levels_change_a_byte(level, threads):
    assert results(level, threads) == results(levels()[0], 1)


@everything
@given(seed=seeds)
def test_a_mirrored_field_has_mirrored_slopes(name, seed):
    field = height_field(seed, 19, 23, 0.5)
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
    given_cells = (np.array([20, 21, 35, 0]), np.array([20, 21, 35, 1]))
    share, mean = load(name).window_means(field, given_cells, (3, 5))
    nothing = np.nan
    # beyond its corner the field's border goes on
    np.testing.assert_allclose(share, [[1 / 9, 2 / 9, 0, 2 / 9], [2 / 25, 2 / 25, 0, 6 / 25]])
    np.testing.assert_allclose(mean, [[4, 1, nothing, 7], [1, 1, nothing, 7]])
    least = load(name).window_minima(field, given_cells, (5, 3))
    np.testing.assert_array_equal(least, [[-2, -2, nothing, 7], [4, -2, nothing, 7]])


FITS = {"field": np.ones((5, 6)), "cells": (np.array([1]), np.array([2])), "sides": (3,)}


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
def test_a_field_of_one_axis_is_named(name):
    with pytest.raises(KernelError, match="field must have"):
        load(name).plane_slopes(np.ones(3))
