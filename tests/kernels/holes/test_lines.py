"""Lines from hole cells to the first measured cell, in the reference of the holes."""

from __future__ import annotations

import numpy as np
from hypothesis import given

from beltscape.kernels.reference.windows import find_first_hits
from tests.kernels.grids import cells_in, height_field
from tests.strategies import seeds


def test_a_line_ends_at_the_first_measured_cell_or_nowhere() -> None:
    measured = np.zeros((9, 12), bool)
    measured[2, 9] = measured[7, 4] = measured[4, 4] = True
    cells = (np.array([2, 4]), np.array([4, 4]))
    down, across = np.array([[0.0], [1.0], [0.5], [0.0]]), np.array([[1.0], [0.0], [0.0], [0.0]])
    cell, steps = find_first_hits(measured, cells, down, across, 20)
    inf = np.inf
    # halves go to even rows: 2, 3, 4, and 4, 5, 6, 6, 6, 7
    np.testing.assert_array_equal(steps, [[5, inf], [2, 3], [3, 1], [inf, 1]])
    np.testing.assert_array_equal(cell, [[2 * 12 + 9, -1], [52, 88], [52, 52], [-1, 52]])
    short = find_first_hits(measured, cells, down, across, 2)
    np.testing.assert_array_equal(short.steps, [[inf, inf], [2, inf], [inf, 1], [inf, 1]])


@given(seed=seeds)
def test_a_mirrored_field_has_mirrored_lines(seed: int) -> None:
    measured = np.isfinite(height_field(seed, 19, 23, 0.5))
    starts, turn = cells_in(seed, measured.shape, 9), np.random.default_rng(seed).uniform(0, 7, (4, 1))
    mirrored = (starts[0], 22 - starts[1])
    ways = np.sin(turn), np.cos(turn)
    one = find_first_hits(measured, starts, *ways, 30)
    other = find_first_hits(measured[:, ::-1], mirrored, ways[0], -ways[1], 30)
    np.testing.assert_array_equal(other.steps, one.steps)
