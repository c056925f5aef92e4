"""Window sums by summed-area tables, and the bands that they are computed in."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from beltscape.kernels.reference.windows import WindowSums, cut_bands
from tests.thorough import examples


@examples(25)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 3, 7, 51]))
def test_sums_are_those_of_the_cells_in_the_window(seed: int, side: int) -> None:
    random = np.random.default_rng(seed)
    rows, columns = random.integers(1, 40, 2)
    fields = random.integers(-1000, 1000, (2, rows, columns))
    place = (random.integers(0, rows, 5), random.integers(0, columns, 5))
    padded = np.pad(fields, ((0, 0), (side // 2, side // 2), (side // 2, side // 2)))
    true = [padded[:, i : i + side, j : j + side].sum(axis=(1, 2)) for i, j in zip(*place, strict=True)]
    np.testing.assert_array_equal(WindowSums(fields).at(place, side), np.transpose(true))
    np.testing.assert_allclose(WindowSums(fields / 8).at(place, side), np.transpose(true) / 8, atol=1e-9)


def test_whole_numbers_that_overflow_in_the_table_are_exact_in_windows() -> None:
    field = np.full((1, 20, 30), 2**56)
    place = (np.array([10]), np.array([20]))
    assert WindowSums(field).at(place, 3)[0, 0] == 9 * 2**56


def test_bands_hold_every_cell_once_with_the_rows_about_it() -> None:
    random = np.random.default_rng(3)
    place = (random.integers(40, 900, 300), random.integers(0, 10, 300))
    found = list(cut_bands(place, 50, 920))
    np.testing.assert_array_equal(np.sort(np.concatenate([own for own, _ in found])), np.arange(300))
    for own, near in found:
        assert near.start <= max(place[0][own].min() - 50, 0)
        assert near.stop >= min(place[0][own].max() + 51, 920)
    assert not list(cut_bands((place[0][:0], place[1][:0]), 50, 920))
