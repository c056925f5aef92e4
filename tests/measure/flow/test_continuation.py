"""Continuation of the fused surface into cells that no frame measured."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from beltscape.measure.flow.continuation import continue_into_holes, continue_surface
from beltscape.measure.holes import Filled
from tests.strategies import seeds

CELL_MM = 1.25
WHOLE = slice(None)
Field = NDArray[np.float64]


def make_plane(rows: int = 40, columns: int = 50) -> Field:
    y, x = np.mgrid[:rows, :columns]
    return 30 + CELL_MM * (0.4 * x - 0.25 * y)


def make_rough_field(seed: int) -> tuple[Field, NDArray[np.bool_]]:
    """Facets of a few levels with holes of all sizes."""
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.uniform(0, 40, (5, 6)), np.ones((8, 8)))
    height = blocks + make_plane(40, 48) + rng.normal(0, 0.1, (40, 48))
    hole = np.kron(rng.random((10, 12)) < 0.3, np.ones((4, 4))) > 0
    return np.where(hole, np.nan, height), hole


def test_a_plane_is_continued() -> None:
    plane = make_plane()
    field = plane.copy()
    field[10:15, 20:26] = field[30:, 10] = np.nan
    found = continue_surface(field, CELL_MM, WHOLE)
    np.testing.assert_array_equal(np.stack(found.at), np.nonzero(np.isnan(field)))
    np.testing.assert_allclose(found.height_mm, plane[found.at], atol=0.1)
    assert (found.probability > 0.25).all()


def test_cells_out_of_reach_have_no_continuation() -> None:
    field = make_plane()
    field[5:35, 10:40] = np.nan
    found = continue_surface(field, CELL_MM, WHOLE)
    row, column = found.at
    far = (row >= 13) & (row < 27) & (column >= 18) & (column < 32)
    assert far.any()
    assert np.isnan(found.height_mm[far]).all()
    assert not found.probability[far].any()
    assert np.isfinite(found.height_mm[~far]).all()


def test_the_better_supported_side_of_a_step_is_continued() -> None:
    """A cell with the low side at seven of eight ends belongs to it, whatever lies above the step."""
    field = np.full((30, 30), 5.0)
    field[:, 18:] = 45.0
    field[15, 16:18] = np.nan
    found = continue_surface(field, CELL_MM, WHOLE)
    at_16 = found.at[1] == 16
    np.testing.assert_allclose(found.height_mm[at_16], 5.0, atol=1e-9)
    assert found.probability[at_16] > found.probability[~at_16]


def test_nothing_is_continued_below_the_belt_and_all_ends() -> None:
    """A slope that ends 2 mm over the belt reaches it, but goes no deeper."""
    field = 2.0 + 2.0 * (20 - np.mgrid[:30, :40][1])
    field[:, 20:] = np.nan
    found = continue_surface(field, CELL_MM, slice(10, 20))
    assert np.nanmin(found.height_mm) == 0.0
    deep = continue_surface(field - 6.0, CELL_MM, slice(10, 20))
    assert np.nanmin(deep.height_mm) == pytest.approx(-2.0)  # the lowest end


def test_probability_falls_with_the_distance() -> None:
    field = make_plane()
    field[:, 20:] = np.nan
    found = continue_surface(field, CELL_MM, slice(20, 21))
    reached = np.isfinite(found.height_mm)
    assert np.count_nonzero(reached) == 8
    assert (np.diff(found.probability[reached]) < 0).all()


@given(seeds, st.sampled_from([0.5, 4.0]))
def test_the_scale_does_not_matter(seed: int, factor: float) -> None:
    field, _ = make_rough_field(seed)
    one, other = (continue_surface(times * field, times * CELL_MM, WHOLE) for times in (1.0, factor))
    np.testing.assert_allclose(other.height_mm, factor * one.height_mm, rtol=1e-6)
    np.testing.assert_allclose(other.probability, one.probability, rtol=1e-6)


@given(seeds)
def test_rows_are_continued_as_in_the_whole_field(seed: int) -> None:
    field, _ = make_rough_field(seed)
    whole, part = continue_surface(field, CELL_MM, WHOLE), continue_surface(field, CELL_MM, slice(12, 25))
    own = (whole.at[0] >= 12) & (whole.at[0] < 25)
    np.testing.assert_array_equal(part.at[0], whole.at[0][own])
    np.testing.assert_array_equal(part.height_mm, whole.height_mm[own])
    np.testing.assert_array_equal(part.probability, whole.probability[own])


@given(seeds)
def test_a_mirrored_field_is_continued_mirrored(seed: int) -> None:
    field, hole = make_rough_field(seed)
    probability = np.zeros((2, *field.shape))
    for plane, given_field in zip(probability, (field, field[::-1, ::-1]), strict=True):
        found = continue_surface(given_field, CELL_MM, WHOLE)
        plane[found.at] = found.probability
    np.testing.assert_allclose(probability[0][hole], probability[1][::-1, ::-1][hole], rtol=1e-6)


@given(seeds)
def test_only_probable_cells_of_holes_are_replaced(seed: int) -> None:
    field, hole = make_rough_field(seed)
    before = Filled(np.where(hole, -7.0, field), np.where(hole, 20.0, 0.1), hole)
    after = continue_into_holes(before, field, CELL_MM, WHOLE)
    np.testing.assert_array_equal(after.hole, hole)
    np.testing.assert_array_equal(after.value_mm[~hole], field[~hole])
    np.testing.assert_array_equal(after.sigma_mm[~hole], before.sigma_mm[~hole])
    found = continue_surface(field, CELL_MM, WHOLE)
    replaced = after.value_mm[found.at] != -7.0
    assert replaced.any()
    assert found.probability[replaced].min() > np.max(found.probability[~replaced], initial=0.0)
    np.testing.assert_array_equal(after.value_mm[found.at][replaced], found.height_mm[replaced])


def test_sigma_is_that_of_both_cases() -> None:
    field = make_plane()
    field[20, 25] = np.nan
    probability = float(continue_surface(field, CELL_MM, WHOLE).probability[0])
    before = Filled(np.nan_to_num(field, nan=10.0), np.where(np.isnan(field), 6.0, 0.1), np.isnan(field))
    whole = continue_into_holes(before, field, CELL_MM, WHOLE)
    expected = np.sqrt(CELL_MM**2 + (1 - probability) * ((whole.value_mm[20, 25] - 10.0) ** 2 + 36.0))
    assert whole.sigma_mm[20, 25] == pytest.approx(expected)


def test_rows_of_a_field_are_replaced_where_they_lie() -> None:
    field = make_plane()
    field[20, 25] = np.nan
    part = slice(15, 30)
    hole = np.isnan(field)
    before = Filled(np.nan_to_num(field, nan=-7.0), np.ones(field.shape), hole)
    whole = continue_into_holes(before, field, CELL_MM, WHOLE)
    after = continue_into_holes(before.cut(part), field, CELL_MM, part)
    np.testing.assert_array_equal(after.value_mm, whole.value_mm[part])
    assert after.value_mm[5, 25] == pytest.approx(make_plane()[20, 25], abs=0.05)
