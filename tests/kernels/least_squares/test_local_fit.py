"""Local fit: each level agrees with the reference; planes, steps and variances are as the theory states."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.least_squares import MOST_DISAGREEMENT, RADII
from beltscape.kernels.native import levels
from tests.kernels.grids import WIDTHS, surface
from tests.kernels.rounding import emulated, first_alike
from tests.strategies import seeds
from tests.thorough import examples

every_level = pytest.mark.parametrize("level", (*levels(), *emulated()))
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
widths = st.sampled_from(WIDTHS)
windows = st.sampled_from(
    [
        ((1, 0.8),), ((2, 5.0),), ((3, 0.7),), ((5, 2.5),), ((2, 1.0), (4, 2.0)), RADII,
        ((1, 0.5), (2, 1.0), (3, 1.0), (6, 3.0)),
    ]
)  # fmt: skip
tolerances = st.sampled_from([0.05, 0.7, 1.0, 3.0, 40.0])


def scene(seed: int, height: int, width: int, unknown: float = 0.03) -> list[np.ndarray]:
    """Information, pull, s and slopes (height, width); a tenth of s and a share of each other is NaN."""
    rng = np.random.default_rng(seed)
    s = surface(seed, height, width)
    information = rng.exponential(20, s.shape)
    pull = rng.normal(0, 0.3, s.shape) * information
    slopes = rng.normal(0, 0.1, (2, *s.shape))
    for field in (information, pull, *slopes):
        field[rng.random(s.shape) < unknown] = np.nan
    return [a.astype(np.float32) for a in (information, pull, s, *slopes)]


def planar(seed: int, size: int) -> tuple[np.ndarray, float, float]:
    by_u, by_v, offset = np.random.default_rng(seed).uniform(-0.5, 0.5, 3)
    v, u = np.indices((size, size))
    return (300 + offset + by_u * u + by_v * v).astype(np.float32), by_u, by_v


def assert_fits_match(found, expected, where=True):
    # A variance is an element of an inverse: a corner's window of few pixels multiplies float32's rounding.
    for name, rtol, atol in (
        ("s", 2e-4, 1e-4), ("slope_u", 2e-4, 1e-4), ("slope_v", 2e-4, 1e-4), ("variance", 1e-3, 1e-5)
    ):  # fmt: skip
        a, b = (np.where(where, getattr(fit, name), 0) for fit in (found, expected))
        np.testing.assert_allclose(a, b, rtol=rtol, atol=atol, err_msg=name)


@every_level
@given(
    seeds,
    widths,
    widths,
    windows,
    tolerances,
    st.sampled_from([0.0, 1.0, 30.0]),
    st.sampled_from([0.0, 0.4, 1.0]),
)
def test_native_agrees_with_the_reference(level, seed, height, width, radii, tolerance, prior, flatten):
    """Where no two windows' intervals lie within rounding of each other; a window fits in alone, too."""
    given = scene(seed, height, width, 0.03 if prior else 0.0)  # a weight of rounding alone is no weight
    fit = [
        partial(load(name).local_fit, *given, tolerance=tolerance, prior_information=prior, flatten=flatten)
        for name in ("reference", level)
    ]
    expected, found = (f(radii=radii) for f in fit)
    assert found.s.dtype == found.variance.dtype == np.float32
    same, there = found.scale == expected.scale, np.isfinite(expected.s)
    assert_fits_match(found, expected, same)
    assert (same | near_a_decision(fit[0], radii)).all()
    if len(radii) > 1:  # told by values that are rounded: as far as those may be off
        spread = np.sqrt(fit[0](radii=radii[:-1], confidence_width=1e9).variance)
        apart = np.sqrt([f.disagreement for f in (found, expected)])
        np.testing.assert_array_less(np.abs(apart[0] - apart[1])[there] * spread[there], 3e-4)


def near_a_decision(fit, radii) -> np.ndarray:
    """(H, W) where the choice between two windows is not clear by 1e-3 of their intervals."""
    chosen = [fit(radii=radii, confidence_width=width).scale for width in (1.998, 2.0, 2.002)]
    return (chosen[0] != chosen[1]) | (chosen[2] != chosen[1])


@everything
@given(seeds, windows, st.sampled_from([0.0, 1.0]))
def test_a_plane_stays_and_gives_its_slopes(name, seed, radii, prior):
    s, by_u, by_v = planar(seed, 14)
    one, none = np.ones_like(s), np.zeros_like(s)
    slopes = np.full_like(s, by_u), np.full_like(s, by_v)
    fit = load(name).local_fit(one, none, s, *slopes, radii=radii, tolerance=0.5, prior_information=prior)
    np.testing.assert_allclose(fit.s, s, atol=2e-4)
    np.testing.assert_allclose(fit.slope_u, by_u, atol=2e-4)
    np.testing.assert_allclose(fit.slope_v, by_v, atol=2e-4)
    assert (fit.scale == len(radii) - 1).all()


@everything
@given(seeds)
def test_slopes_are_found_from_none(name, seed):
    s, by_u, by_v = planar(seed, 16)
    one, none = np.ones_like(s), np.zeros_like(s)
    slopes, inner = (none, none), slice(3, -3)
    for _ in range(6):
        fit = load(name).local_fit(
            one, none, s, *slopes, radii=((3, 2.0),), tolerance=4.0, prior_information=0.0
        )
        slopes = fit.slope_u, fit.slope_v
    np.testing.assert_allclose(slopes[0][inner, inner], by_u, atol=1e-3)
    np.testing.assert_allclose(slopes[1][inner, inner], by_v, atol=1e-3)


@everything
def test_a_surface_that_is_not_flattened_keeps_its_shape(name):
    """It only moves by what the pulls have in common."""
    v, u = np.indices((24, 30)) - 12.0
    s, one, none = 200 + 0.01 * (u**2 + v**2), np.full((24, 30), 50.0), np.zeros((24, 30))
    fit = partial(load(name).local_fit, one, s=s, slope_u=0.02 * u, slope_v=0.02 * v, tolerance=5.0)
    np.testing.assert_array_equal(fit(none, flatten=0.0).s, s.astype(np.float32))
    np.testing.assert_allclose(fit(0.1 * one, flatten=0.0, prior_information=0.0).s - s, 0.1, rtol=1e-3)
    assert (fit(none).s[8:-8, 8:-8] - s[8:-8, 8:-8] > 0.01).all()


@everything
@given(seeds, st.floats(-0.9, 0.9))
def test_a_common_change_is_taken_whole_without_a_prior(name, seed, change):
    s, by_u, by_v = planar(seed, 14)
    information = np.random.default_rng(seed).uniform(1, 50, s.shape)
    slopes = np.full_like(s, by_u), np.full_like(s, by_v)
    fit = load(name).local_fit(
        information, change * information, s, *slopes, tolerance=0.5, prior_information=0.0
    )
    np.testing.assert_allclose(fit.s - s, change, atol=3e-4)


@everything
def test_a_step_is_bounded_and_the_prior_holds(name):
    s, none = np.full((12, 12), 100.0), np.zeros((12, 12))
    for information, prior, change in ((1.0, 0.0, 1.0), (1.0, 9.0, 0.5), (1.0, 99.0, 0.05)):
        fit = load(name).local_fit(
            none + information, none + 5, s, none, none, tolerance=1.0, prior_information=prior
        )
        np.testing.assert_allclose(fit.s - s, change, rtol=1e-3)
        down = load(name).local_fit(
            none + information, none - 5, s, none, none, tolerance=1.0, prior_information=prior
        )
        np.testing.assert_allclose(down.s - s, -change, rtol=1e-3)


@everything
@examples(20)
@given(seeds)
def test_nothing_is_smoothed_across_a_step(name, seed):
    """Both sides come out as they do alone."""
    s, by_u, by_v = planar(seed, 24)
    rng = np.random.default_rng(seed)
    information, pull = rng.exponential(20, s.shape) + 1, rng.normal(0, 3, s.shape)
    slopes = np.full_like(s, by_u), np.full_like(s, by_v)
    s[:, 12:] += 2.0
    fit = partial(load(name).local_fit, information, pull, tolerance=1.0)
    whole = fit(s, *slopes)
    for side in (np.s_[:, :12], np.s_[:, 12:]):
        alone = np.full_like(s, np.nan)
        alone[side] = s[side]
        np.testing.assert_array_equal(fit(alone, *slopes).s[side], whole.s[side])


@everything
def test_the_variance_is_that_of_the_value(name):
    """400 planes with noise of the stated information; one window."""
    rng = np.random.default_rng(5)
    information = rng.exponential(20, (9, 9)) + 2
    none, noise = np.zeros((9, 9)), rng.normal(size=(400, 9, 9))
    fits = [
        load(name).local_fit(
            information, sample * np.sqrt(information), none + 50, none, none, radii=((4, 2.0),),
            tolerance=1e3, prior_information=0.0,
        )
        for sample in noise
    ]  # fmt: skip
    values = [fit.s[4, 4] for fit in fits]
    assert 0.85 < np.var(values) / fits[-1].variance[4, 4] < 1.15


@everything
def test_windows_disagree_on_what_is_not_plane(name):
    """Little where only noise moves them, up to the most where a cone's tip is cut."""
    v, u = np.indices((41, 41)) - 20.0
    rng, none = np.random.default_rng(6), np.zeros((41, 41))
    information = none + 100.0
    noise = rng.normal(size=none.shape) * np.sqrt(information)
    fit = partial(load(name).local_fit, information, s=none, slope_u=none, slope_v=none, tolerance=10.0)
    even, cone = fit(noise), fit(noise + information * np.hypot(u, v))
    assert 0.1 < np.mean(even.disagreement) < 1.0
    assert cone.disagreement[20, 20] == MOST_DISAGREEMENT
    assert not fit(noise, radii=((4, 2.0),)).disagreement.any()


@everything
def test_a_curved_surface_takes_smaller_windows_with_more_information(name):
    v, u = np.indices((40, 40)) - 20.0
    s, none = np.full((40, 40), 200.0), np.zeros((40, 40))
    scales = []
    for information in (1.0, 1e3, 1e6):
        pull = information * 0.002 * (u**2 + v**2)
        fit = load(name).local_fit(
            none + information, pull, s, none, none, radii=RADII, tolerance=1.0, prior_information=0.0
        )
        scales.append(int(fit.scale[20, 20]))
    assert scales == [2, 1, 0]


@everything
def test_without_information_nothing_changes(name):
    s = surface(3, 12, 17, holes=0.2)
    rng, none = np.random.default_rng(3), np.zeros_like(s)
    slopes = rng.normal(size=(2, *s.shape)).astype(np.float32)
    fit = load(name).local_fit(none, none, s, *slopes, tolerance=1.0, prior_information=0.0)
    there = np.isfinite(s)
    for found, before in zip(fit[:3], (s, *slopes), strict=True):
        np.testing.assert_array_equal(found[there], before[there])
        assert np.isnan(found[~there]).all()
    assert np.isinf(fit.variance[there]).all()
    assert np.isnan(fit.variance[~there]).all()
    assert not fit.scale[~there].any()


@everything
@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf])
def test_a_missing_pixel_has_no_weight(name, nothing):
    """What it says besides is not asked, and it stays missing."""
    information, pull, s, *slopes = scene(8, 20, 21)
    s[5:8, 6:9] = nothing
    fit = load(name).local_fit(information, pull, s, *slopes, tolerance=1.0)
    information[5:8, 6:9], pull[5:8, 6:9] = 1e6, -1e6
    other = load(name).local_fit(information, pull, s, *slopes, tolerance=1.0)
    for a, b in zip(fit, other, strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.isnan(fit.s[5:8, 6:9]).all()
    assert np.isfinite(fit.s[np.isfinite(s)]).all()


def result(level: str, threads: int) -> list[bytes]:
    return [a.tobytes() for a in load(level).local_fit(*scene(4, 131, 85), tolerance=1.0, threads=threads)]


@every_level
@pytest.mark.parametrize("threads", [0, 2, 5])
def test_neither_threads_nor_levels_change_a_byte(level, threads):
    assert result(level, threads) == result(first_alike(level), 1)


@everything
def test_wrong_input_is_named(name):
    grid = np.ones((5, 6))
    fit = partial(load(name).local_fit, *[grid] * 5)
    for call, message in (
        (lambda: load(name).local_fit(grid, grid[:4], grid, grid, grid, tolerance=1.0),
         "pull must have the shape (5, 6), not (4, 6)"),
        (lambda: fit(tolerance=0.0), "tolerance must be at least 0.001 and at most 1000, not 0"),
        (lambda: fit(tolerance=np.nan), "tolerance must be at least 0.001 and at most 1000, not nan"),
        (lambda: fit(tolerance=1.0, confidence_width=-1), "confidence_width must be at least 0, not -1"),
        (lambda: fit(tolerance=1.0, prior_information=np.inf), "prior_information must be at least 0, not inf"),
        (lambda: fit(tolerance=1.0, flatten=1.5), "flatten must be at least 0 and at most 1, not 1.5"),
        (lambda: fit(tolerance=1.0, radii=()), "radii must be 1 to 4 windows, not 0"),
        (lambda: fit(tolerance=1.0, radii=((3, 1.0), (3, 2.0))), "radii must ascend within 1 to 15 px, not 3, 3"),
        (lambda: fit(tolerance=1.0, radii=((16, 1.0),)), "radii must ascend within 1 to 15 px, not 16"),
        (lambda: fit(tolerance=1.0, radii=((2, 2.0), (3, 1.5))),
         "the sigmas of larger windows must not be less, not 2, 1.5"),
        (lambda: fit(tolerance=1.0, radii=((2, 0.0),)), "a window's sigma must be at least 0.001, not 0"),
    ):  # fmt: skip
        with pytest.raises(KernelError) as error:
            call()
        assert str(error.value) == message
