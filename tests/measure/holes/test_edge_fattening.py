"""Edge fattening above drops: its cells and features."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.learned.registry import load_network
from beltscape.measure.holes.edge_fattening import find_edge_fattening

X, Y = np.meshgrid(np.arange(80.0), np.arange(60.0))
LEVEL = np.zeros((2, *X.shape))


def test_cells_above_a_drop_are_found() -> None:
    hole = (X >= 30) & (X < 34)
    step = np.where(hole, np.nan, np.where(X < 30, 25.0, 0.0))
    found = find_edge_fattening(step, LEVEL, 1.0)
    assert set(found.cells[1]) == {29}
    assert len(found.cells[0]) == 60
    np.testing.assert_allclose(found.drop_mm, 25)
    assert len(find_edge_fattening(np.where(hole, np.nan, 0.4 * X), LEVEL, 1.0).drop_mm) == 0


@pytest.mark.parametrize("drop", [10.0, 60.0])
def test_excess_is_part_of_the_drop(drop: float) -> None:
    hole = (X >= 30) & (X < 33)
    step = np.where(hole, np.nan, np.where(X < 30, drop, 0.0))
    too_high, sigma = find_edge_fattening(step, LEVEL, 1.0).predict_excess_mm(load_network("edge_fattening"))
    assert (too_high <= drop).all()
    assert (too_high >= -0.5 * drop).all()
    assert (sigma > 0).all()
    assert (sigma <= drop).all()


def test_features_do_not_depend_on_the_unit() -> None:
    rng = np.random.default_rng(3)
    field = np.where(np.hypot(X - 40, Y - 30) < 15, 30.0, 0.0) + rng.random(X.shape)
    field[rng.random(X.shape) < 0.1] = np.nan
    one, other = find_edge_fattening(field, LEVEL, 1.0), find_edge_fattening(25.4 * field, LEVEL, 25.4)
    for name, values in one.features.items():
        np.testing.assert_allclose(other.features[name], values, atol=1e-4)
    np.testing.assert_allclose(other.drop_mm, 25.4 * one.drop_mm)
