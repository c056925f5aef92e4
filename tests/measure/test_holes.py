"""Filling of occlusion holes: heights, σ and symmetries."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from beltscape.kernels import load
from beltscape.kernels.reference import holes
from beltscape.measure.holes import Filled, fill_holes
from tests.thorough import examples

Turn = Callable[[np.ndarray], np.ndarray]
X, Y = np.meshgrid(np.arange(90.0), np.arange(90.0))
OUT = np.hypot(X - 45, Y - 45)


def filled(value: np.ndarray, sigma_mm: float = 0.1, cell_mm: float = 1.0) -> Filled:
    sigma = np.where(np.isfinite(value), sigma_mm, np.nan)
    return fill_holes(value, sigma, np.zeros(value.shape, bool), cell_mm)


SMOOTH = {
    "level": 5 + 0 * X,
    "slope": 3 + 0.4 * X - 0.2 * Y + 20,
    "steep slope": 0.8 * X,
    "bowl": 0.005 * OUT**2,
    "sphere": np.sqrt(150.0**2 - OUT**2) - 80,
    "waves": 20 + 6 * np.sin(X / 50) * np.cos(Y / 55),
}


@pytest.mark.parametrize("place", [(45, 45), (30, 52)])
@pytest.mark.parametrize("surface", SMOOTH)
def test_smooth_surface_continues_in_its_holes(surface: str, place: tuple[int, int]) -> None:
    truth = SMOOTH[surface]
    hole = np.hypot(X - place[0], Y - place[1]) < 8
    noise = 0.05 * np.random.default_rng(0).standard_normal(X.shape)
    for measured, within in ((truth, 0.3), (truth + noise, 0.6)):
        found = filled(np.where(hole, np.nan, measured))
        off = np.abs(found.value_mm - truth)[hole]
        assert off.max() < within
        assert off.mean() < 3 * found.sigma_mm[hole].mean()
        assert found.sigma_mm[hole].max() < 2


def rocks(seed: int) -> np.ndarray:
    """A field with bumps and steps, full of holes."""
    rng = np.random.default_rng(seed)
    balls = rng.uniform([0, 0, 6], [90, 90, 22], (25, 3))
    square = [r**2 - (X - x) ** 2 - (Y - y) ** 2 for x, y, r in balls]
    field = np.sqrt(np.clip(np.max(square, axis=0), 0, None))
    hole = ndimage.binary_dilation(rng.random(X.shape) < 0.01, iterations=3) | (
        np.hypot(*np.gradient(field)) > 2
    )
    return np.where(hole, np.nan, field + 0.1 * rng.standard_normal(X.shape))


@examples(8)
@given(st.integers(0, 1000), st.sampled_from([np.fliplr, np.flipud, np.transpose, np.rot90]))
def test_a_mirrored_or_turned_field_is_filled_mirrored_or_turned(seed: int, turned: Turn) -> None:
    field = rocks(seed)
    one, other = filled(field), filled(turned(field).copy())
    # outside, of several nearest cells any may go on
    inner = np.s_[15:-15, 15:-15]
    np.testing.assert_allclose(other.value_mm[inner], turned(one.value_mm)[inner], atol=1e-2)
    np.testing.assert_allclose(other.sigma_mm[inner], turned(one.sigma_mm)[inner], atol=1e-2)


@examples(8)
@given(st.integers(0, 1000))
def test_filled_heights_lie_between_the_belt_and_the_neighbourhood(seed: int) -> None:
    field = rocks(seed)
    found = filled(field)
    assert found.value_mm[found.hole].max() <= np.nanmax(field)
    assert found.value_mm[found.hole].min() >= min(np.nanmin(field), 0)
    assert np.isfinite(found.value_mm).all()
    assert (found.sigma_mm[found.hole] > 0).all()


def test_hole_behind_a_step_is_filled_at_the_lower_side() -> None:
    step = np.where(X < 45, 40.0, 0.0)
    hole = (X >= 45) & (X < 55)
    found = filled(np.where(hole, np.nan, step))
    own = found.value_mm[20:70]
    # the hole is at the level of the lower side, to a tenth of the step
    assert own[:, 45:55].min() / 40 > -0.1
    assert own[:, 45:55].max() / 40 < 0.1
    # near what hides it more may be hidden than near the far rim
    assert found.sigma_mm[45, 46] > 1.5 * found.sigma_mm[45, 53]


def test_a_flat_rim_leaves_little_doubt_and_a_rough_one_much() -> None:
    rough = 5 * np.random.default_rng(0).standard_normal(X.shape)
    hole = np.hypot(X - 30, Y - 25) < 6
    assert filled(np.where(hole, np.nan, 0.0)).sigma_mm[25, 30] < 0.15
    assert filled(np.where(hole, np.nan, rough)).sigma_mm[25, 30] > 0.5


def test_one_flying_cell_on_the_rim_moves_no_hole() -> None:
    value = np.where(np.hypot(X - 30, Y - 25) < 6, np.nan, 0.0)
    clean = filled(value).value_mm[25, 30]
    value[25, 24] = 80.0
    assert abs(filled(value).value_mm[25, 30] - clean) < 5


def test_border_is_extrapolated_with_growing_sigma() -> None:
    value = np.where(X < 60, 10.0 + Y, np.nan)
    found = filled(value)
    np.testing.assert_allclose(found.value_mm[25, 89], 35, atol=1)
    assert np.isfinite(found.value_mm).all()
    assert found.hole.sum() == 90 * 30
    assert found.sigma_mm[25, 89] > 5


def test_rows_alone_are_filled_as_they_are_with_all_the_others() -> None:
    field = rocks(4)
    field[:, :6] = np.nan
    nothing, rows = np.zeros(X.shape, bool), slice(30, 60)
    part = fill_holes(field, np.where(np.isfinite(field), 0.1, np.nan), nothing, 1.0, rows=rows)
    np.testing.assert_allclose(part.value_mm[rows], filled(field).value_mm[rows], atol=1e-6)
    measured = np.isfinite(field)
    np.testing.assert_array_equal(np.isfinite(part.value_mm[:30]), measured[:30])
    np.testing.assert_array_equal(np.isfinite(part.value_mm[60:]), measured[60:])


def test_a_field_without_anything_is_refused() -> None:
    with pytest.raises(ValueError, match="nothing to interpolate"):
        filled(np.full((9, 9), np.nan))


def test_a_field_without_holes_has_no_inputs() -> None:
    heights = np.random.default_rng(2).uniform(10, 20, (20, 30))
    none, slope = np.zeros(heights.shape, bool), np.zeros((2, *heights.shape))
    assert load().hole_inputs(heights, none, slope, 4.0).features.shape[1] == 0


def test_memory_of_the_reference_is_bounded_and_the_number_of_cells_at_once_changes_nothing(
    monkeypatch,
) -> None:
    monkeypatch.setenv("BELTSCAPE_KERNELS", "reference")
    load.cache_clear()
    field = rocks(3)
    whole = filled(field)
    most: list[int] = []

    def count(lines, cells, *others):
        most.append(len(cells[0]))
        return trace(lines, cells, *others)

    trace = holes.trace_lines
    monkeypatch.setattr(holes, "trace_lines", count)
    monkeypatch.setattr(holes, "_CELLS_AT_ONCE", 50)
    parts = filled(field)
    load.cache_clear()
    assert max(most) == 50
    np.testing.assert_allclose(parts.value_mm, whole.value_mm, atol=1e-9)
    np.testing.assert_allclose(parts.sigma_mm, whole.sigma_mm, atol=1e-9)
