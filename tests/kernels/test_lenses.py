"""Lens models in the kernels: each level agrees with the reference, and nothing is seen beyond a domain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS
from beltscape.kernels import load
from beltscape.kernels.native import NativeBackend, levels
from beltscape.kernels.projection import LENS, PROJECTION_SIZE, pack_lens
from beltscape.kernels.reference.view import distort, project
from tests.kernels.grids import project_grid, surface, texture, view_of_seed
from tests.kernels.rounding import first_alike
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", levels())
SCALES = {
    **{"k1": 0.2, "k2": 0.1, "k3": 0.03, "k4": 0.1, "k5": 0.05, "k6": 0.02, "p1": 2e-3, "p2": 2e-3},
    **{"s1": 3e-3, "s2": 1e-3, "s3": 3e-3, "s4": 1e-3, "tau_x": 0.15, "tau_y": 0.15},
}


class Tangents(NamedTuple):
    """Input of `arc_tangents`."""

    tangents: np.ndarray


def lens_of_seed(model: str, seed: int) -> np.ndarray:
    """Random plausible coefficients."""
    scale = np.array([SCALES[name] for name in MODELS[model].coefficients])
    return np.random.default_rng(seed).uniform(-1, 1, len(scale)) * scale


def view_with(model: str, seed: int) -> np.ndarray:
    """An auxiliary with a lens model and the domain of its coefficients."""
    view, lens = view_of_seed(seed), lens_of_seed(model, seed)
    camera = Camera("c", (48, 40), np.full(2, 60.0), np.array([24.0, 20.0]), lens, model)
    view[LENS] = pack_lens(model, lens, camera.valid_radius)
    return view


def smooth(view: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Where a pixel and its neighbours in s lie within the domain, and off the border of a footprint."""
    u, v = project_grid(view, s)
    ahead, behind = project_grid(view, s + np.float32(0.01)), project_grid(view, s - np.float32(0.01))
    inside = np.isfinite(ahead[0]) & np.isfinite(behind[0])
    at_edge = np.minimum.reduce([np.abs(u - 1), np.abs(u - 46), np.abs(v - 1), np.abs(v - 38)]) < 2e-3
    return inside & ~at_edge


@pytest.mark.parametrize("model", MODELS)
@given(seed=seeds)
def test_the_reference_is_the_camera(model, seed):
    lens = lens_of_seed(model, seed)
    camera = Camera("c", (48, 40), np.ones(2), np.zeros(2), lens, model)
    row = pack_lens(model, lens, camera.valid_radius)
    ideal = np.random.default_rng(seed).uniform(-1, 1, (50, 2))
    assert len(row) + LENS.start == PROJECTION_SIZE
    np.testing.assert_allclose(np.stack(distort(row, *ideal.T), axis=-1), camera.distort(ideal), atol=1e-14)


@every_level
@pytest.mark.parametrize("model", MODELS)
@given(seed=seeds)
def test_native_warps_agree_with_the_reference(level, model, seed):
    view, s, coefficients = view_with(model, seed), surface(seed, 9, 37), texture(seed, 40, 48)
    expected, expected_slope = load("reference").warp(s, view, coefficients)
    value, slope = load(level).warp(s, view, coefficients)
    compared = smooth(view, s)
    np.testing.assert_array_equal(np.isnan(value)[compared], np.isnan(expected)[compared])
    both = np.isfinite(value) & np.isfinite(expected) & compared
    np.testing.assert_allclose(value[both], expected[both], atol=0.02)
    np.testing.assert_allclose(slope[both], expected_slope[both], atol=0.05)


@every_level
@pytest.mark.parametrize("model", MODELS)
def test_native_pixels_are_exact_to_single_precision(level, model):
    """An image that is its own column number measures where a pixel is seen."""
    columns = np.tile(np.arange(1200, dtype=np.float32), (8, 1))
    kernels = load(level)
    coefficients = kernels.spline_coefficients(columns)
    s = np.linspace(-0.9, 0.9, 4001, dtype=np.float32)[None]
    row = pack_lens(model, lens_of_seed(model, 3))
    view = np.concatenate([[0, 0, 0, 0, 0, 0.001, 0, 0, 1, 1, 0, 0, 600, 1, 600, 3.5], row]).astype(
        np.float32
    )
    u, _, _ = project(
        view, np.arange(s.size, dtype=np.float64)[None], np.zeros(s.shape), s.astype(np.float64)
    )
    value, slope = kernels.warp(s, view, coefficients)
    inner = (u > 30) & (u < 1170)  # the fold of the mirrored edges dies out by 0.27 a pixel
    assert inner.sum() > 2000
    np.testing.assert_allclose(
        value[inner], u[inner], atol=6e-4
    )  # of 1200: a unit in the last place is 1.2e-4
    expected = np.gradient(u[0], s[0].astype(float), edge_order=2)[None]
    np.testing.assert_allclose(slope[inner], expected[inner], rtol=1e-3)


@every_level
@pytest.mark.parametrize("model", MODELS)
@given(seed=seeds)
def test_native_visibility_agrees_with_the_reference(level, model, seed):
    view, s = view_with(model, seed), surface(seed, 12, 37)
    u, v = project_grid(view, s)
    close = np.minimum(*(np.abs(a - half - np.round(a - half)) for a in (u, v) for half in (0.0,))) < 2e-3
    s[close] = np.nan
    sizes = [(48, 40)]
    (expected,) = load("reference").inverse_depth_buffers(s, view[None], sizes)
    (found,) = load(level).inverse_depth_buffers(s, view[None], sizes)
    np.testing.assert_allclose(found, expected, rtol=1e-4)


@pytest.mark.parametrize("name", ["reference", *levels()])
@pytest.mark.parametrize("model", MODELS)
def test_nothing_is_seen_beyond_the_domain(name, model):
    view, s = view_of_seed(4), np.full((40, 48), 10, np.float32)
    view[LENS] = pack_lens(model, np.zeros(len(MODELS[model].coefficients)), 0.25)
    unlimited = view.copy()
    unlimited[LENS] = pack_lens(model, np.zeros(len(MODELS[model].coefficients)))
    everywhere = np.ones((400, 400))
    view[14:16] = unlimited[14:16] = 200
    within, _ = load(name).warp(s, view, everywhere)
    assert np.isfinite(load(name).warp(s, unlimited, everywhere)[0]).all()
    v, u = np.indices(s.shape)
    x = (view[:9].reshape(3, 3).astype(float) @ np.stack([u, v, np.ones_like(u)]).reshape(3, -1)).reshape(
        3, 40, 48
    )
    x += view[9:12, None, None].astype(float) * 10
    radius = np.hypot(x[0], x[1]) / x[2]
    clear = np.abs(radius - 0.25) > 1e-5
    np.testing.assert_array_equal(np.isfinite(within)[clear], (radius < 0.25)[clear])
    assert 0 < np.isfinite(within).sum() < within.size


@every_level
@pytest.mark.parametrize("model", MODELS)
def test_neither_threads_nor_levels_change_a_byte(level, model):
    s, view, image = surface(2, 40, 48), view_with(model, 3), texture(4, 40, 48)
    found = [array.tobytes() for array in load(level).warp(s, view, image, threads=5)]
    assert found == [array.tobytes() for array in load(first_alike(level)).warp(s, view, image, threads=1)]


@every_level
@given(st.floats(0, 2.0**100, width=32))
def test_the_arc_tangent_is_exact_to_a_unit_in_the_last_place(level, value):
    near = np.concatenate([np.linspace(0, 4, 997), np.geomspace(1e-30, 1e30, 997), [value, np.inf]])
    tangents = near.astype(np.float32)
    angles = np.empty_like(tangents)
    NativeBackend(level).run("arc_tangents", Tangents(tangents), (angles,), 1)
    expected = np.arctan(tangents.astype(np.float64))
    np.testing.assert_allclose(angles, expected, rtol=0, atol=1.1e-7)
    np.testing.assert_allclose(angles, expected, rtol=2e-7, atol=0)
