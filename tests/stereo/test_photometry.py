"""Grey levels of the cameras: contrast, channels, bits, noise and texture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.stereo.multiview.photometry import (
    WINDOW_PX,
    compute_grey_levels,
    compute_local_mean,
    compute_local_variance,
    compute_texture_ratio,
    estimate_noise_variance,
)
from tests.stereo.raycast import make_speckle

PATTERN = np.rint(make_speckle()[:160, :200]).astype(np.uint8)
"""Counts 2 to about 200."""


@given(st.floats(0.55, 1.1), st.floats(0.55, 1.1))
def test_levels_of_all_cameras_have_the_cores_contrast(darker, brighter):
    gains = {"core": 1.0, "a": darker, "b": brighter}
    images = {name: np.rint(PATTERN * (257 * gain)).astype(np.uint16) for name, gain in gains.items()}
    levels = compute_grey_levels(images, "core")
    np.testing.assert_allclose(levels["core"], PATTERN, rtol=1e-6)
    for level in levels.values():
        assert level.std() == pytest.approx(PATTERN.std(), rel=1e-4)
        np.testing.assert_allclose(level, PATTERN, atol=0.02)


def test_dark_camera_is_at_most_doubled_and_a_black_one_unchanged():
    images = {"core": PATTERN, "dim": PATTERN // 5, "black": np.zeros_like(PATTERN)}
    levels = compute_grey_levels(images, "core")
    np.testing.assert_array_equal(levels["dim"], 2.0 * (PATTERN // 5))
    assert not levels["black"].any()


@pytest.mark.parametrize(
    ("shares", "weights"), [((1, 0, 0), (1, 0, 0)), ((1.0, 0.5, 0.0), (2 / 3, 1 / 3, 0))]
)
def test_channels_are_weighted_by_their_contrast(shares, weights):
    image = np.stack([np.rint(PATTERN * share) for share in shares], axis=-1).astype(np.uint8)
    found = compute_grey_levels({"core": image}, "core")["core"]
    np.testing.assert_allclose(found, image @ np.array(weights), atol=0.5)


def test_pattern_in_one_channel_dominates_noise_in_the_others():
    rng = np.random.default_rng(2)
    image = 60 + rng.normal(0, 6, (*PATTERN.shape, 3))
    image[..., 1] += PATTERN
    image = np.clip(image, 0, 255).astype(np.uint8)
    level = compute_grey_levels({"core": image}, "core")["core"]

    def correlate(values):
        return np.corrcoef(values.ravel(), PATTERN.ravel())[0, 1]

    assert correlate(level) > 0.98
    assert 1 - correlate(level) < 0.5 * (1 - correlate(image.mean(axis=-1)))


@pytest.mark.parametrize("channels", [1, 3])
def test_sixteen_bits_give_the_levels_of_eight(channels):
    eight = PATTERN if channels == 1 else np.stack([PATTERN, PATTERN // 2, 255 - PATTERN], axis=-1)
    images = {"core": eight, "a": (eight * 0.8).astype(np.uint8)}
    deep = {name: image.astype(np.uint16) * 257 for name, image in images.items()}
    first, second = compute_grey_levels(images, "core"), compute_grey_levels(deep, "core")
    for name in images:
        assert first[name].dtype == np.float32
        np.testing.assert_allclose(second[name], first[name], rtol=1e-5, atol=1e-3)


def test_colour_and_grey_cameras_have_equal_contrast():
    levels = compute_grey_levels({"core": np.repeat(PATTERN[..., None], 3, axis=-1), "a": PATTERN}, "core")
    np.testing.assert_allclose(levels["a"], levels["core"], rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("sigma", [1.0, 3.0, 8.0])
def test_noise_is_estimated_from_the_least_textured_parts(sigma):
    scene = PATTERN.astype(np.float32)
    scene[:, 120:] = 40 + 0.2 * np.arange(80)  # a shading without texture
    noisy = scene + np.random.default_rng(3).normal(0, sigma, scene.shape)
    assert 1 / 1.5 < estimate_noise_variance(noisy.astype(np.float32)) / sigma**2 < 1.5


def test_noise_is_never_below_that_of_eight_bits():
    assert estimate_noise_variance(np.full((40, 50), 7, np.float32)) == pytest.approx(1 / 12)
    assert estimate_noise_variance(np.zeros((3, 5), np.float32)) == pytest.approx(1 / 12)


def test_local_moments_equal_those_of_the_window():
    level = PATTERN[:40, :50].astype(np.float32)
    size = 2 * WINDOW_PX + 1
    windows = np.lib.stride_tricks.sliding_window_view(level, (size, size)).astype(float)
    inside = (slice(WINDOW_PX, -WINDOW_PX),) * 2
    np.testing.assert_allclose(compute_local_mean(level)[inside], windows.mean(axis=(2, 3)), rtol=1e-4)
    np.testing.assert_allclose(compute_local_variance(level)[inside], windows.var(axis=(2, 3)), rtol=1e-3)
    assert compute_local_variance(np.full((30, 30), 200, np.float32)).min() >= 0


def test_texture_excludes_planes_and_noise():
    rng = np.random.default_rng(5)
    v, u = np.mgrid[:120, :160].astype(np.float32)
    shading, noise = 30 + 0.7 * u + 0.4 * v, rng.normal(0, 1, u.shape)
    bright = np.where(u < 80, 1.0, 2.5)  # photon noise grows with brightness
    smooth = compute_texture_ratio((shading + bright * noise).astype(np.float32), 1.0, 9)
    inside = (slice(10, -10), slice(10, -10))
    assert 0.6 < np.median(smooth[inside]) < 1.1
    assert np.percentile(smooth[inside], 99.9) < 2
    dots = cv2.GaussianBlur(rng.normal(0, 1, u.shape), (0, 0), 1.5) * 60
    assert (
        np.percentile(compute_texture_ratio((shading + dots + noise).astype(np.float32), 1.0, 9)[inside], 1)
        > 5
    )


def test_finest_texture_does_not_count_as_noise():
    level = np.random.default_rng(6).normal(100, 30, (60, 70)).astype(np.float32)
    assert compute_texture_ratio(level, 1.0, 9)[10:-10, 10:-10].min() > 20
