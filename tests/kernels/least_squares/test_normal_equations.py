"""Normal equations: each level agrees with the reference; the pull leads to the true surface."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from tests.kernels.grids import STRAIGHT, WIDTHS, project_grid, surface, texture, view_of_seed
from tests.kernels.rounding import emulated, first_alike
from tests.strategies import seeds
from tests.thorough import examples

every_level = pytest.mark.parametrize("level", (*levels(), *emulated()))
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
widths = st.sampled_from(WIDTHS)

SETTINGS: dict[str, Any] = {"floor": 4.0, "noise_variance": 1.5, "model_variance": 0.0025}
LENIENT: dict[str, Any] = {"floor": 4.0, "noise_variance": 50.0, "model_variance": 1.0}
"""So that textures that have nothing to do with each other pass the gate."""


def scene(seed: int, height: int, width: int, count: int = 2):
    """s, core, coefficients and views; s is NaN where a view's border is within rounding."""
    s, core = surface(seed, height, width), texture(seed, height, width)
    core[np.random.default_rng(seed).random(core.shape) < 0.03] = np.nan
    views = np.stack([view_of_seed(seed + k) for k in range(count)])
    for view in views:
        u, v = project_grid(view, s)
        away = np.minimum.reduce([np.abs(u - 1), np.abs(u - 46), np.abs(v - 1), np.abs(v - 38)])
        s[~(away > 1e-3)] = np.nan
    return s, core, [texture(seed + k + 1, 40, 48) for k in range(count)], views


def shifted(seed: int, height: int = 40, width: int = 48, s: float = 3.3):
    """A core and the spline of an auxiliary that sees it displaced by s, from an image wider by 8."""
    kernels = load("reference")
    image = kernels.spline_coefficients(texture(seed, height, width + 8))
    core, _ = kernels.warp(np.full((height, width), s), STRAIGHT, image)
    return core, image


inner = (slice(3, -4), slice(2, -2))


@every_level
@given(seeds, widths, widths, st.integers(1, 9), st.integers(0, 4))
def test_native_agrees_with_the_reference(level, seed, height, width, window, residual_window):
    both = [
        load(name).normal_equations(
            *scene(seed, height, width), **LENIENT, window=window, residual_window=residual_window
        )
        for name in ("reference", level)
    ]
    expected, found = both
    assert found.information.dtype == found.pull.dtype == np.float32
    for a, b in zip(found[:2], expected[:2], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4 * np.abs(expected.information).max())


@every_level
@examples(20)
@given(seeds, st.sampled_from([0.5, 3.0, 30.0]))
def test_the_same_views_are_used(level, seed, gate):
    """But where the gate is within rounding."""
    given = scene(seed, 12, 17, 3)
    used = [
        load("reference").normal_equations(*given, **LENIENT, gate=g * gate).used for g in (0.99, 1, 1.01)
    ]
    found = load(level).normal_equations(*given, **LENIENT, gate=gate).used
    clear = used[0] == used[2]
    np.testing.assert_array_equal(found[clear], used[1][clear])
    assert clear.mean() > 0.9


@everything
@given(seeds)
def test_the_true_surface_is_not_drawn_away(name, seed):
    core, image = shifted(seed, 24, 30)
    found = load(name).normal_equations(np.full(core.shape, 3.3), core, [image], STRAIGHT[None], **SETTINGS)
    assert (found.used[inner] == 1).all()
    assert np.median(found.information[inner]) > 10
    np.testing.assert_allclose(found.pull / (found.information + 1), 0, atol=1e-3)


@everything
@given(seeds, st.floats(-0.1, 0.1))
def test_the_pull_leads_to_the_truth(name, seed, off):
    """A window's pulls over its information: Newton's step, true to second order."""
    core, image = shifted(seed)
    found = load(name).normal_equations(
        np.full(core.shape, 3.3 - off), core, [image], STRAIGHT[None], **SETTINGS
    )
    step = found.pull[inner].sum() / found.information[inner].sum()
    assert step == pytest.approx(off, abs=0.05 * abs(off) + 1e-4)


@everything
@examples(20)
@given(seeds, st.floats(0.3, 3), st.floats(-50, 50))
def test_gain_and_offset_of_a_camera_do_not_matter(name, seed, gain, offset):
    core, image = shifted(seed)
    s = np.full(core.shape, 3.2)
    fit = partial(load(name).normal_equations, s, core, views=STRAIGHT[None], floor=1e-3, noise_variance=0.0,
                  model_variance=0.01)  # fmt: skip
    plain, other = fit(coefficients=[image])[:2], fit(coefficients=[image * gain + offset])[:2]
    for a, b in zip(plain, other, strict=True):
        whole = a[10:-10, 10:-10]  # beyond, the core stands in for what is not seen
        np.testing.assert_allclose(b[10:-10, 10:-10], whole, rtol=0.02, atol=0.01 * np.abs(whole).max())


@everything
@examples(20)
@given(seeds)
def test_views_add_up_in_any_order(name, seed):
    s, core, images, views = scene(seed, 11, 17, 3)
    fit = partial(load(name).normal_equations, s, core, **LENIENT)
    whole = fit(images, views)
    alone = [fit([image], view[None]) for image, view in zip(images, views, strict=True)]
    turned = fit(images[::-1], views[::-1])
    for i in range(3):
        parts = np.sum([part[i] for part in alone], axis=0)
        scale = np.abs(whole[0]).max()
        np.testing.assert_allclose(whole[i], parts, rtol=1e-5, atol=1e-6 * scale)
        np.testing.assert_allclose(turned[i], whole[i], rtol=1e-5, atol=1e-6 * scale)


@everything
def test_a_view_of_nothing_adds_nothing(name):
    core, image = shifted(4)
    s, away = np.full(core.shape, 3.2), STRAIGHT + np.eye(39, dtype=np.float32)[14] * 1000
    fit = partial(load(name).normal_equations, s, core, **SETTINGS)
    for a, b in zip(
        fit([image, image], np.stack([STRAIGHT, away])), fit([image], STRAIGHT[None]), strict=True
    ):
        np.testing.assert_array_equal(a, b)
    assert not any(field.any() for field in fit([image], away[None]))


@everything
@examples(20)
@given(seeds, st.integers(1, 8), st.integers(0, 3))
def test_a_hole_reaches_no_farther_than_the_windows(name, seed, window, residual_window):
    core, image = shifted(seed)
    s = np.full(core.shape, 3.2)
    fit = partial(load(name).normal_equations, coefficients=[image], views=STRAIGHT[None], window=window,
                  residual_window=residual_window, **SETTINGS)  # fmt: skip
    whole, reach = fit(s, core), window + residual_window
    holed, blind = core.copy(), s.copy()
    holed[20, 24] = blind[20, 24] = np.nan
    v, u = np.indices(core.shape)
    far = np.maximum(np.abs(v - 20), np.abs(u - 24)) > reach
    for found in (fit(s, holed), fit(blind, core)):
        for field, before in zip(found, whole, strict=True):
            assert field[20, 24] == 0
            np.testing.assert_array_equal(field[far], before[far])
            assert np.isfinite(field).all()


@everything
def test_textureless_images_give_no_information(name):
    flat = np.full((20, 30), 100.0)
    found = load(name).normal_equations(flat * 0 + 2, flat, [flat], STRAIGHT[None], **SETTINGS)
    np.testing.assert_allclose(found.information, 0, atol=1e-6)
    np.testing.assert_allclose(found.pull, 0, atol=1e-4)
    assert (found.used[1:-2, 1:-4] == 1).all()


@everything
def test_a_view_that_shows_something_else_is_not_used(name):
    core, image = shifted(7)
    other = image.copy()
    other[10:30, 15:40] = load("reference").spline_coefficients(texture(8, 20, 25))
    fit = partial(
        load(name).normal_equations, np.full(core.shape, 3.3), core, views=STRAIGHT[None], **SETTINGS
    )
    true, false = fit(coefficients=[image]), fit(coefficients=[other])
    patch = np.s_[15:25, 17:30]
    assert (true.used[patch] == 1).all()
    assert (false.used[patch] == 0).mean() > 0.95
    assert np.median(false.information[patch]) < 0.1 * np.median(true.information[patch])


def result(level: str, threads: int) -> list[bytes]:
    s, views = surface(2, 149, 77), np.stack([view_of_seed(k, 77, 149) for k in (3, 5)])
    core, images = texture(1, 149, 77), [texture(4, 149, 77), texture(6, 140, 81)]
    found = load(level).normal_equations(s, core, images, views, **LENIENT, threads=threads)
    assert (found.information > 1e-3).mean() > 0.5
    return [a.tobytes() for a in found]


@every_level
@pytest.mark.parametrize("threads", [0, 2, 5])
def test_neither_threads_nor_levels_change_a_byte(level, threads):
    assert result(level, threads) == result(first_alike(level), 1)


@every_level
@given(seeds, st.integers(1, 4), st.integers(0, 4))
def test_bands_of_rows_leave_no_seam(level, seed, window, residual_window):
    """Rows far below do not change the rows above, wherever the grid is cut into bands."""
    s, views = surface(seed, 140, 20), np.stack([view_of_seed(seed, 20, 140)])
    core, images = texture(seed, 140, 20), [texture(seed + 1, 140, 20)]
    fit = partial(load(level).normal_equations, coefficients=images, views=views, window=window,
                  residual_window=residual_window, **LENIENT)  # fmt: skip
    whole = fit(s, core)
    for rows in (50, 66, 100):
        kept = rows - window - residual_window
        for a, b in zip(fit(s[:rows], core[:rows]), whole, strict=True):
            np.testing.assert_array_equal(a[:kept], b[:kept])


@everything
def test_wrong_input_is_named(name):
    grid = np.ones((5, 6))
    equations, rows = load(name).normal_equations, STRAIGHT[None]
    fit = partial(equations, grid, grid, [grid], rows)
    for call, message in (
        (lambda: equations(grid, grid[:4], [grid], rows, **SETTINGS), "core must have the shape (5, 6), not (4, 6)"),
        (lambda: equations(grid, grid, [], rows, **SETTINGS), "normal equations need at least one auxiliary"),
        (lambda: equations(grid, grid, [grid] * 2, rows, **SETTINGS),
         "views must have the shape (2, 39), not (1, 39)"),
        (lambda: equations(grid, grid, [grid[:3]], rows, **SETTINGS),
         "coefficients must be of at least 4 × 4 pixels, not (3, 6)"),
        (lambda: fit(**SETTINGS, window=0), "window must be 1 to 15 px, not 0"),
        (lambda: fit(**SETTINGS, residual_window=16), "residual_window must be 0 to 15 px, not 16"),
        (lambda: fit(**SETTINGS, gate=0.0), "gate must be positive, not 0"),
        (lambda: fit(**(SETTINGS | {"floor": np.nan})), "floor must be positive, not nan"),
        (lambda: fit(**(SETTINGS | {"noise_variance": -1.0})), "noise_variance must be at least 0, not -1"),
        (lambda: fit(**(SETTINGS | {"model_variance": 0.0})), "model_variance must be positive, not 0"),
    ):  # fmt: skip
        with pytest.raises(KernelError) as error:
            call()
        assert str(error.value) == message
