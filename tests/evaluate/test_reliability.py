"""Reliability of a depth map: false fill, σ ratios and pixel locking."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.evaluate.frame_scores import compute_false_fill, compute_pixel_locking, compute_sigma_ratios


def depth_map(z: np.ndarray) -> DepthMap:
    ones = np.ones(z.shape, np.float32)
    return DepthMap(z.astype(np.float32), ones, ones.astype(np.uint8), ones)


def test_false_fill_counts_depth_at_occluded_pixels():
    z = np.full((4, 5), 700.0)
    z[0, :3] = np.nan
    hidden = np.zeros((4, 5), bool)
    hidden[0] = True
    assert compute_false_fill(depth_map(z), hidden) == pytest.approx(2 / 5)
    assert np.isnan(compute_false_fill(depth_map(z), np.zeros((4, 5), bool)))


def test_sigma_ratios_reveal_too_small_sigma():
    rng = np.random.default_rng(3)
    sigma = rng.uniform(0.1, 1.0, 50_000)
    actual = np.where(sigma < 0.28, 2 * sigma, sigma)  # the most certain fifth is too sure
    ratios = compute_sigma_ratios(rng.normal(0, actual), sigma)
    assert ratios == pytest.approx([2, 1, 1, 1, 1], rel=0.05)


def test_sigma_ratios_of_too_few_pixels_are_unknown():
    assert np.isnan(compute_sigma_ratios(np.zeros(2), np.ones(2))[2:]).all()


def test_pixel_locking_is_the_peak_to_peak_of_an_error_that_follows_the_grid():
    rng = np.random.default_rng(4)
    true = rng.uniform(20, 60, 200_000)
    locked = true + 0.05 * np.sin(2 * np.pi * true) + rng.normal(0, 0.03, true.size)
    assert compute_pixel_locking(locked, true) == pytest.approx(0.1, rel=0.06)
    assert compute_pixel_locking(true + 0.2 + rng.normal(0, 0.03, true.size), true) < 0.003


def test_pixel_locking_leaves_false_matches_out_and_needs_every_fraction():
    true = np.linspace(0, 10, 1001)
    wrong = true.copy()
    wrong[::7] += 40
    assert compute_pixel_locking(wrong, true) == 0
    assert np.isnan(compute_pixel_locking(np.arange(9.0), np.arange(9.0)))
