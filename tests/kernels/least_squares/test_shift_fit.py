"""The displacement of a field of heights: each level equals the reference and finds known shifts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage
from scipy.ndimage import shift  # pyrefly: ignore[missing-module-attribute]

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.least_squares import FittedShift
from beltscape.kernels.native import levels
from tests.strategies import seeds

everything = pytest.mark.parametrize("name", ["reference", *levels()])
SHAPE = 60, 50


def make_surface(seed: int, shape: tuple[int, int] = SHAPE) -> NDArray[np.float64]:
    """A smooth rough surface, which splines interpolate well."""
    return 40 * ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), 3)


def move(surface: NDArray[np.float64], along: float, across: float) -> NDArray[np.float64]:
    """The surface displaced towards larger rows and columns; NaN where it came from outside."""
    return shift(surface, (along, across), order=3, cval=np.nan)


def fit(
    name: str, before: NDArray[np.float64], after: NDArray[np.float64], start: int, side: int = 10
) -> FittedShift:
    return load(name).fit_shift(before, after, start, side=side)


@pytest.mark.parametrize("level", levels())
@given(
    seeds,
    st.integers(-12, 12),
    st.floats(-0.9, 0.9),
    st.floats(-1.5, 1.5),
    st.sampled_from([0.0, 0.1, 0.6, 0.97]),
)
def test_native_is_the_reference(level, seed, start, part, across, holes):
    rng = np.random.default_rng(seed)
    before = make_surface(seed)
    after = move(before, start + part, across) + 0.05 * rng.standard_normal(SHAPE)
    after[rng.random(SHAPE) < 0.05] += 5.0
    for field in (before, after):
        lost = ndimage.gaussian_filter(rng.standard_normal(SHAPE), 2)
        field[lost < np.quantile(lost, holes)] = np.nan
    found, expected = (fit(name, before, after, start) for name in (level, "reference"))
    np.testing.assert_allclose(found.shift, expected.shift, atol=1e-6)
    np.testing.assert_allclose(found.variance, expected.variance, rtol=1e-5, atol=1e-12)


@everything
@pytest.mark.parametrize(("along", "across"), [(0.0, 0.0), (7.3, -0.4), (-11.6, 1.2)])
def test_a_known_shift_is_found_in_spite_of_noise_and_gross_errors(name, along, across):
    rng, before = np.random.default_rng(1), make_surface(1)
    after = move(before, along, across) + 0.02 * rng.standard_normal(SHAPE) + 3.0
    after[20:30, 10:30] += 20.0
    found = fit(name, before, after, round(along))
    assert found.shift == pytest.approx([along, across], abs=0.02)
    assert 0 < found.variance[0] < 0.02**2


@everything
def test_what_the_fields_do_not_determine_is_unknown(name):
    surface = make_surface(2)
    plane = np.add.outer(np.arange(60.0), np.zeros(50))
    unknown = np.full(SHAPE, np.nan)
    for before, after, start in ((surface, unknown, 0), (surface, surface, 59), (plane, plane, 0)):
        found = fit(name, before, after, start)
        assert np.isnan([*found.shift, *found.variance]).all()


@everything
def test_a_fit_that_leaves_its_start_has_diverged(name):
    x = np.arange(60.0)
    hill = np.add.outer(40 * np.exp(-(((x - 30) / 12) ** 2)), np.sin(np.arange(50.0)))
    assert np.isnan(fit(name, hill, move(hill, 8.0, 0.0), 0).shift).all()


@everything
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"before": np.ones(5)}, "before must have the shape (Ny, Nx) of 2 and more, not (5,)"),
        ({"after": np.ones((5, 5))}, "after must have the shape (5, 6), not (5, 5)"),
        ({"side": 0}, "side must be at least 1 cell, not 0"),
    ],
)
def test_arguments_that_do_not_fit_are_named(name, change, message):
    fits = {"before": np.ones((5, 6)), "after": np.ones((5, 6)), "start": 0, "side": 3}
    with pytest.raises(KernelError) as error:
        load(name).fit_shift(**(fits | change))
    assert str(error.value) == message
