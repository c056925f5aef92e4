"""Quadratic surfaces fitted around holes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.kernels.reference.hole_rims import fit_quadrics
from tests.thorough import examples

Y, X = np.mgrid[-40.0:40.0, -300.0:-220.0]


@examples(20)
@given(
    st.tuples(*[st.floats(-2, 2)] * 3, *[st.floats(-0.02, 0.02)] * 3),
    st.integers(0, 9),
    st.sampled_from([25, 51]),
)
def test_a_quadratic_is_found_again_from_any_of_its_cells(
    terms: tuple[float, ...], seed: int, side: int
) -> None:
    a, b, c, d, e, f = terms
    field = a + b * (X + 260) + c * Y + d * (X + 260) ** 2 + e * (X + 260) * Y + f * Y**2
    hole = np.random.default_rng(seed).random(X.shape) < 0.5
    inner = np.zeros(hole.shape, bool)
    inner[10:-10, 10:-10] = hole[10:-10, 10:-10]
    found = fit_quadrics(np.where(hole, np.nan, field), np.nonzero(inner), (side,))
    relief = np.ptp(field) + 1
    np.testing.assert_allclose(found.value_mm[0], field[inner], atol=1e-3 * relief)
    assert found.rms_mm.max() < 2e-3 * relief
    assert (found.leverage > 0.5).all()


def test_what_does_not_follow_one_misses_it_by_its_noise() -> None:
    field = 0.3 * np.random.default_rng(0).standard_normal(X.shape)
    found = fit_quadrics(field, (np.array([40]), np.array([40])), (51,))
    assert found.rms_mm[0, 0] == pytest.approx(0.3, rel=0.05)
    assert found.value_mm[0, 0] == pytest.approx(0, abs=0.05)


def test_cells_along_a_line_or_far_off_carry_none() -> None:
    line = np.where(Y == 3, 1.0, np.nan)
    place = (np.array([40, 45]), np.array([40, 40]))
    assert np.isnan(fit_quadrics(line, place, (25,)).value_mm).all()
    far = np.where(X < -270, 1.0, np.nan)
    assert np.isnan(fit_quadrics(far, (np.array([40]), np.array([42])), (25,)).value_mm).all()
