"""The saddle model of a corner: derivatives, exact fits, and the Cramér–Rao bound."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.calibration.detection.subpixel import CornerWindows, Saddles, fit_saddles

TRUE = np.array([[0.31, -0.22, 1.9, 0.25, np.log(0.8), 120.0, 0.4, -0.3, 70.0]])


def windows(noise: float = 0.0, seed: int = 0, radius: int = 8, count: int = 1) -> CornerWindows:
    grid = np.arange(-radius, radius + 1.0)
    x, y = (np.tile(a.ravel(), (count, 1)) for a in np.meshgrid(grid, grid))
    empty = CornerWindows(x, y, np.zeros_like(x), np.ones_like(x))
    values, _ = Saddles(np.tile(TRUE, (count, 1))).linearise(empty)
    rng = np.random.default_rng(seed)
    return CornerWindows(x, y, values + rng.normal(0, noise, values.shape), np.ones_like(x))


def start(count: int = 1) -> Saddles:
    moved = TRUE + np.array([0.7, -0.6, 0.06, -0.08, 0.4, -15, -0.4, 0.3, -20])
    return Saddles(np.tile(moved, (count, 1)))


@pytest.mark.parametrize("column", range(9))
def test_derivatives_equal_numeric_ones(column):
    around = windows()
    step = np.zeros((1, 9))
    step[0, column] = 1e-6
    (plus, _), (minus, _) = (Saddles(TRUE + s * step).linearise(around) for s in (1, -1))
    _, derivatives = Saddles(TRUE).linearise(around)
    np.testing.assert_allclose(derivatives[:, column], (plus - minus) / 2e-6, atol=2e-6)


def test_an_exact_corner_is_fitted_exactly():
    found, rms = fit_saddles(windows(), start())
    np.testing.assert_allclose(found.offset_px, TRUE[:, :2], atol=1e-4)
    assert found.blur_px == pytest.approx(0.8, abs=1e-3)
    assert found.contrast == pytest.approx(70.0, abs=0.05)
    assert rms < 0.05


def test_noise_displaces_corners_to_the_cramer_rao_bound():
    noise, count = 2.0, 400
    around = windows(noise, count=count)
    found, rms = fit_saddles(around, start(count))
    _, derivatives = Saddles(TRUE).linearise(windows())
    bound = np.sqrt(np.diag(np.linalg.inv(derivatives[0] @ derivatives[0].T / noise**2))[:2])
    np.testing.assert_allclose(found.offset_px.std(axis=0), bound, rtol=0.12)  # the Cramér-Rao bound
    np.testing.assert_allclose(
        found.offset_px.mean(axis=0), TRUE[0, :2], atol=4 * bound.max() / np.sqrt(count)
    )
    assert rms.mean() == pytest.approx(noise, rel=0.03)


def test_unused_pixels_have_no_effect():
    clean = windows(1.0)
    spoiled = np.where(clean.x > 5, 255.0, clean.values)
    used = (clean.x <= 5).astype(float)
    found, _ = fit_saddles(CornerWindows(clean.x, clean.y, spoiled, used), start())
    same, _ = fit_saddles(CornerWindows(clean.x, clean.y, clean.values, used), start())
    np.testing.assert_array_equal(found.parameters, same.parameters)


def test_one_corner_without_a_fit_does_not_disturb_the_others():
    both = windows(1.0, count=2)
    values = both.values.copy()
    values[1] = 255.0
    found, _ = fit_saddles(CornerWindows(both.x, both.y, values, both.used), start(2))
    alone, _ = fit_saddles(CornerWindows(both.x[:1], both.y[:1], both.values[:1], both.used[:1]), start(1))
    np.testing.assert_allclose(found.parameters[0], alone.parameters[0], atol=1e-3)
