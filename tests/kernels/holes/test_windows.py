"""Statistics of windows and of bends in the reference of the holes, on fields with known results."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from beltscape.kernels.reference import windows
from beltscape.kernels.reference.windows import (
    collect_bends,
    fit_plane_slopes,
    fit_quadratics,
    window_means,
    window_minima,
)
from tests.kernels.grids import assert_identical, cells_in, height_field
from tests.strategies import seeds


def test_a_ramp_has_no_bends_and_a_parabola_its_second_difference() -> None:
    along = np.arange(40.0)
    ramp, parabola = np.add.outer(3 * along, 2 * along), np.tile(along**2, (5, 1))
    ramp[3, 4] = np.nan
    assert np.median(collect_bends(ramp, 1, -1.0)) == pytest.approx(0, abs=1e-12)
    assert len(collect_bends(parabola, 30, -1.0)) == 0
    bends = collect_bends(parabola, 4, -1.0)
    assert len(bends) == 5 * 32
    assert np.median(bends) == pytest.approx(16)


def test_a_tall_field_may_be_cut_into_bands(monkeypatch) -> None:
    field = height_field(3, 300, 9, 0.3)
    given = field, cells_in(3, field.shape, 90), (9, 25)
    whole = fit_quadratics(*given), window_means(*given)
    monkeypatch.setattr(windows, "_BAND_ROWS", 40)
    np.testing.assert_allclose(fit_quadratics(*given), whole[0], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(window_means(*given), whole[1], rtol=1e-9, atol=1e-9)


@given(seed=seeds)
def test_a_mirrored_field_has_mirrored_slopes(seed: int) -> None:
    field = height_field(seed, 19, 23, 0.5)
    across, down = fit_plane_slopes(field)
    other_across, other_down = fit_plane_slopes(field[:, ::-1])
    np.testing.assert_allclose(other_across[:, ::-1], -across, atol=1e-9)
    np.testing.assert_allclose(other_down[:, ::-1], down, atol=1e-9)


def test_a_plane_has_its_slopes_wherever_it_was_measured() -> None:
    y, x = np.mgrid[:20, :30].astype(float)
    field = 0.3 * x - 0.7 * y
    field[np.random.default_rng(0).random(field.shape) < 0.3] = np.nan
    slope = fit_plane_slopes(field)
    known = np.isfinite(field)
    np.testing.assert_allclose(slope[:, known], np.tile([[0.3], [-0.7]], known.sum()), atol=1e-9)
    assert (slope[:, ~known] == 0).all()
    lone = np.where((y == 3) | ((x == 20) & (y == 15)), field, np.nan)
    assert (fit_plane_slopes(lone) == 0).all()


def test_means_and_minima_are_those_of_the_windows_and_nothing_of_empty_ones() -> None:
    field = np.full((40, 40), np.nan)
    field[20, 20], field[21, 22], field[0, 0] = 4.0, -2.0, 7.0
    cells = (np.array([20, 21, 35, 0]), np.array([20, 21, 35, 1]))
    nothing = np.nan
    # beyond its corner the field's border goes on
    share, mean = window_means(field, cells, (3, 5))
    np.testing.assert_allclose(share, [[1 / 9, 2 / 9, 0, 2 / 9], [2 / 25, 2 / 25, 0, 6 / 25]])
    np.testing.assert_allclose(mean, [[4, 1, nothing, 7], [1, 1, nothing, 7]])
    least = window_minima(field, cells, (5, 3))
    assert_identical((least,), (np.array([[-2, -2, nothing, 7], [4, -2, nothing, 7]]),))
