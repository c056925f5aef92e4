"""Sigma of the mean over the pairs."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.stereo.pairwise.reconstructor import estimate_sigma, fuse_depths

SCALE = 700.0**2
"""px·mm: at 700 mm one pixel of disparity is one millimetre."""


@pytest.mark.parametrize("noise_px", [0.1, 0.3])
@pytest.mark.parametrize("count", [2, 4])
def test_sigma_predicts_independent_errors_from_the_scatter(noise_px, count):
    rng = np.random.default_rng(5)
    depths = (700 + rng.normal(0, noise_px, (count, 80, 90))).astype(np.float32)
    fused = fuse_depths(depths, None)
    actual = np.std(fused.depth_mm - 700)
    assert 0.8 < actual / np.median(estimate_sigma(fused, SCALE)) < 1.25


def test_sigma_is_larger_where_the_pairs_differ():
    depths = np.random.default_rng(5).normal(700, 0.1, (4, 40, 40)).astype(np.float32)
    depths[:, 20, 20] = [699, 700, 700.5, 701]
    sigma = estimate_sigma(fuse_depths(depths, None), SCALE)
    assert sigma[20, 20] > 4 * np.median(sigma)


def test_sigma_exists_for_one_pair_and_not_for_unmeasured_pixels():
    depths = np.full((1, 30, 30), 700, np.float32)
    depths[0, 5:10, 5:10] = np.nan
    sigma = estimate_sigma(fuse_depths(depths, None), SCALE)
    assert np.array_equal(np.isnan(sigma), np.isnan(depths[0]))
    assert sigma[20, 20] == pytest.approx(0.09, rel=0.05)
