"""The photometric gain of auxiliaries, and the variance of level differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.stereo.multiview.photoconsistency import compute_difference_variance, estimate_gain
from beltscape.stereo.multiview.surface import compute_visibility, subsample_projection
from tests.stereo.scenes import Scene, make_scene, mask_inner, patch, plane, with_scale

STEP = (plane(820), patch(560, (-90, 90), (-130, 130)))


def estimate(made: Scene, cost: np.ndarray | float = 0.0) -> list[np.ndarray]:
    prepared = with_scale(made.prepared)
    _, buffers = compute_visibility(made.s, prepared.views, prepared.sizes, load())
    return estimate_gain(made.s, np.full(made.s.shape, cost), prepared, buffers).gains


def with_levels(made: Scene, factor: np.ndarray) -> Scene:
    """Return the scene with the core's levels multiplied by a factor."""
    prepared = made.prepared
    return replace(made, prepared=replace(prepared, core=(prepared.core * factor).astype(np.float32)))


@pytest.mark.parametrize("solids", [(plane(),), STEP])
def test_gain_of_equally_bright_images_is_one(solids):
    made = make_scene(*solids, noise=1.0)
    for gain in estimate(made):
        assert gain.shape == made.s.shape
        assert np.median(np.abs(gain - 1)) < 0.02
        assert np.abs(gain - 1)[mask_inner(gain.shape, 8)].max() < 0.2


def test_gain_follows_changes_over_the_image():
    made = make_scene(plane(), noise=1.0)
    width = made.s.shape[1]
    factor = np.linspace(0.7, 1.2, width)[None] + np.zeros((made.s.shape[0], 1))
    inside = mask_inner(made.s.shape, 12)
    for gain, before in zip(estimate(with_levels(made, factor)), estimate(made), strict=True):
        np.testing.assert_allclose((gain / before)[inside], factor[inside], rtol=0.06)


def test_dissimilar_pixels_hardly_affect_the_gain():
    made = make_scene(plane(), noise=1.0)
    factor = np.ones(made.s.shape)
    factor[30:60, 40:80] = 3.0
    cost = np.where(factor > 1, 0.9, 0.0)
    for gain in estimate(with_levels(made, factor), cost):
        assert np.abs(gain - 1)[mask_inner(gain.shape, 8)].max() < 0.15


def test_gain_without_visible_pixels_is_one():
    made = make_scene(plane(), noise=1.0)
    nothing = replace(made, s=np.full_like(made.s, np.nan))
    for gain in estimate(nothing):
        np.testing.assert_array_equal(gain, 1)


def test_subsampled_projection_is_that_of_every_fourth_pixel():
    made = make_scene(*STEP)
    view, coefficients = made.prepared.views[1], made.prepared.coefficients[1]
    whole, _ = load().warp(made.s, view, coefficients)
    thin = np.ascontiguousarray(made.s[2::4, 2::4])
    found, _ = load().warp(thin, subsample_projection(view, 4), coefficients)
    np.testing.assert_allclose(found, whole[2::4, 2::4], atol=0.05)


def test_variance_of_differences_rises_with_level_and_slope():
    made = make_scene(plane(), noise=2.0)
    noise = made.prepared.noise
    dark, bright = (
        compute_difference_variance(np.full((9, 9), level, np.float32), noise) for level in (0, 200)
    )
    np.testing.assert_allclose(dark, 3 * noise.levels, rtol=1e-5)
    np.testing.assert_allclose(bright - dark, 100, rtol=1e-3)
    rising = np.tile(np.arange(9, dtype=np.float32) * 20, (9, 1))
    ramp = compute_difference_variance(rising, noise)
    np.testing.assert_allclose(ramp[4, 4] - dark[4, 4] - (0.05 * 80) ** 2, (0.15 * 20) ** 2, rtol=1e-3)
