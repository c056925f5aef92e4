from __future__ import annotations

import numpy as np
import pytest

from beltscape.measure.holes.edge_fattening import brinks
from beltscape.measure.network import load_network

X, Y = np.meshgrid(np.arange(80.0), np.arange(60.0))
LEVEL = np.zeros((2, *X.shape))


def test_only_what_stands_above_a_drop_is_one() -> None:
    hole = (X >= 30) & (X < 34)
    step = np.where(hole, np.nan, np.where(X < 30, 25.0, 0.0))
    found = brinks(step, LEVEL, 1.0)
    assert set(found.place[1]) == {29}
    assert len(found.place[0]) == 60
    np.testing.assert_allclose(found.drop_mm, 25)
    assert len(brinks(np.where(hole, np.nan, 0.4 * X), LEVEL, 1.0).drop_mm) == 0


@pytest.mark.parametrize("drop", [10.0, 60.0])
def test_what_lies_beyond_is_part_of_the_drop(drop: float) -> None:
    hole = (X >= 30) & (X < 33)
    step = np.where(hole, np.nan, np.where(X < 30, drop, 0.0))
    too_high, sigma = brinks(step, LEVEL, 1.0).beyond(load_network("brinks"))
    assert (too_high <= drop).all()
    assert (too_high >= -0.5 * drop).all()
    assert (sigma > 0).all()
    assert (sigma <= drop).all()


def test_height_and_cell_in_another_unit_are_the_same() -> None:
    rng = np.random.default_rng(3)
    field = np.where(np.hypot(X - 40, Y - 30) < 15, 30.0, 0.0) + rng.random(X.shape)
    field[rng.random(X.shape) < 0.1] = np.nan
    one, other = brinks(field, LEVEL, 1.0), brinks(25.4 * field, LEVEL, 25.4)
    np.testing.assert_allclose(other.features, one.features, atol=1e-4)
    np.testing.assert_allclose(other.drop_mm, 25.4 * one.drop_mm)
