"""Ray march: each level equals the reference to the bit, on lines with known ends."""

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
shares = st.sampled_from([0.0, 0.02, 0.5, 0.9, 1.0])
counts = st.sampled_from([0, 1, 5, 40])


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
    given = measured, cells_in(seed, measured.shape, count), down, across, most
    assert_identical(load(level).first_hits(*given, threads=2), load("reference").first_hits(*given))


def results(level: str, threads: int) -> list[bytes]:
    field, turn = height_field(5, 300, 61, 0.6), np.linspace(0, 6, 9)[:, None]
    measured = np.isfinite(field)
    ends = load(level).first_hits(
        measured, np.nonzero(~measured), np.sin(turn), np.cos(turn), 90, threads=threads
    )
    return [array.tobytes() for array in ends]


@every_level
@pytest.mark.parametrize("threads", [0, 2, 5])
def test_neither_threads_nor_levels_change_a_byte(level, threads):
    assert results(level, threads) == results(levels()[0], 1)


@everything
def test_a_line_ends_at_the_first_measured_cell_or_nowhere(name):
    measured = np.zeros((9, 12), bool)
    measured[2, 9] = measured[7, 4] = measured[4, 4] = True
    given_cells = (np.array([2, 4]), np.array([4, 4]))
    down, across = np.array([[0.0], [1.0], [0.5], [0.0]]), np.array([[1.0], [0.0], [0.0], [0.0]])
    cell, steps = load(name).first_hits(measured, given_cells, down, across, 20)
    inf = np.inf
    # halves go to even rows: 2, 3, 4, and 4, 5, 6, 6, 6, 7
    np.testing.assert_array_equal(steps, [[5, inf], [2, 3], [3, 1], [inf, 1]])
    np.testing.assert_array_equal(cell, [[2 * 12 + 9, -1], [52, 88], [52, 52], [-1, 52]])
    short = load(name).first_hits(measured, given_cells, down, across, 2)
    np.testing.assert_array_equal(short.steps, [[inf, inf], [2, inf], [inf, 1], [inf, 1]])


@everything
@given(seed=seeds)
def test_a_mirrored_field_has_mirrored_lines(name, seed):
    measured = np.isfinite(height_field(seed, 19, 23, 0.5))
    starts, turn = cells_in(seed, measured.shape, 9), np.random.default_rng(seed).uniform(0, 7, (4, 1))
    mirrored = (starts[0], 22 - starts[1])
    ways = np.sin(turn), np.cos(turn)
    one = load(name).first_hits(measured, starts, *ways, 30)
    other = load(name).first_hits(measured[:, ::-1], mirrored, ways[0], -ways[1], 30)
    np.testing.assert_array_equal(other.steps, one.steps)


LINES = {
    "measured": np.ones((5, 6), bool), "cells": (np.array([1, 4]), np.array([2, 5])),
    "down": np.ones((3, 1)), "across": np.ones((3, 1)), "most": 4,
}  # fmt: skip


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
