from __future__ import annotations

import numpy as np

from beltscape.measure.holes import Filled, fill_holes

X, Y = np.meshgrid(np.arange(60.0), np.arange(50.0))


def filled(value: np.ndarray, sigma_mm: float = 0.1) -> Filled:
    return fill_holes(value, np.where(np.isfinite(value), sigma_mm, np.nan), np.zeros(value.shape, bool), 1.0)


def test_a_hole_in_a_slope_is_filled_by_the_slope() -> None:
    slope = 3 + 0.4 * X - 0.2 * Y
    found = filled(np.where(np.hypot(X - 30, Y - 25) < 8, np.nan, slope))
    np.testing.assert_allclose(found.value_mm, slope, atol=0.5)
    # from a slope alone nobody knows that no pit was hidden: the lowest rim is as likely
    assert 0.5 < found.sigma_mm[25, 30] < 3


def test_behind_a_step_lies_the_lower_side() -> None:
    step = np.where(X < 30, 40.0, 0.0)
    found = filled(np.where((X >= 30) & (X < 40), np.nan, step))
    # the upper side goes on for about a cell
    np.testing.assert_allclose(found.value_mm[10:-10, 31:], step[10:-10, 31:], atol=1e-9)
    assert 20 < found.value_mm[25, 30] < 40
    # near what hides it more may be hidden than near the far rim
    assert found.sigma_mm[25, 31] > 2 * found.sigma_mm[25, 38] > 1


def test_a_flat_rim_leaves_little_doubt_and_a_rough_one_much() -> None:
    rough = 5 * np.random.default_rng(0).standard_normal(X.shape)
    hole = np.hypot(X - 30, Y - 25) < 6
    assert filled(np.where(hole, np.nan, 0.0)).sigma_mm[25, 30] < 0.15
    assert filled(np.where(hole, np.nan, rough)).sigma_mm[25, 30] > 0.5


def test_one_flying_cell_on_the_rim_moves_no_hole() -> None:
    value = np.where(np.hypot(X - 30, Y - 25) < 6, np.nan, 0.0)
    value[25, 24] = 80.0
    assert abs(filled(value).value_mm[25, 30]) < 0.1


def test_beyond_the_border_the_nearest_goes_on_and_doubt_grows() -> None:
    value = np.where(X < 40, 10.0 + Y, np.nan)
    found = filled(value)
    np.testing.assert_allclose(found.value_mm[25, 59], 35, atol=1)
    assert np.isfinite(found.value_mm).all()
    assert found.hole.sum() == 50 * 20
