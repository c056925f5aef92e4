"""Rims of holes along lines."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.kernels.reference.hole_rims import find_lowest_line, fit_gradients, trace_lines

X, Y = np.meshgrid(np.arange(-60.0, 60.0), np.arange(-60.0, 60.0))
LEVEL = np.zeros((2, *X.shape))


@pytest.mark.parametrize("turn_deg", [0, 15, 20, 33, 70, 110, 150])
def test_the_floor_at_the_ends_of_a_slot_between_walls_is_found(turn_deg: float) -> None:
    turn = np.deg2rad(turn_deg)
    along = X * np.cos(turn) + Y * np.sin(turn)
    across = np.abs(-X * np.sin(turn) + Y * np.cos(turn))
    walls = (across > 6) & (np.abs(along) < 25)
    hole = (across <= 6) & (np.abs(along) < 25)
    field = np.where(hole, np.nan, np.where(walls, 80.0, 10.0))
    lines = trace_lines(field, np.nonzero(hole), fit_gradients(field, 1.0), LEVEL, 1.0)
    lowest = find_lowest_line(lines, field, np.nonzero(hole), 1.0)
    middle = (across < 2)[hole] & (np.abs(along) < 15)[hole]
    np.testing.assert_array_equal(lowest.upper_mm[middle], 10)
    assert (lowest.gap_mm[middle] > 40).all()
    assert ((lowest.nearer[middle] > 0.1) & (lowest.nearer[middle] <= 0.5)).all()


def test_where_no_line_meets_two_rims_there_is_none() -> None:
    hole = X > 20
    field = np.where(hole, np.nan, 5.0)
    lines = trace_lines(field, np.nonzero(hole), fit_gradients(field, 1.0), LEVEL, 1.0)
    lowest = find_lowest_line(lines, field, np.nonzero(hole), 1.0)
    assert np.isinf(lowest.upper_mm).all()
    assert np.isnan(lowest.nearer).all()
