"""Fusion of the pairs' depths: the mean over the largest agreeing group."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.stereo.pairwise.reconstructor import fuse_depths
from tests.strategies import seeds


def stack(*depths: float) -> np.ndarray:
    return np.array(depths, np.float32).reshape(-1, 1, 1)


NAN = float("nan")
AGREE = 2.0 / 700**2
"""Within 2 mm at 700 mm."""


@pytest.mark.parametrize(
    ("depths", "mean", "views"),
    [
        ((700, 701, 700.5, 700.1), 700.4, 4),
        ((700, 701, NAN, 720), 700.5, 2),
        ((NAN, NAN, 705, NAN), 705, 1),
        ((700, 710, NAN, NAN), NAN, 0),
        ((700, 710, 720, 730), NAN, 0),
        ((700, 701.9, 703.85, NAN), 700.95, 2),
        ((700, 701.5, 710, 710.5), 710.25, 2),
        ((NAN, NAN, NAN, NAN), NAN, 0),
    ],
)
def test_the_largest_agreeing_group_is_averaged(depths, mean, views):
    fused = fuse_depths(stack(*depths), AGREE)
    np.testing.assert_allclose(fused.depth_mm[0, 0], mean, atol=1e-3)
    assert fused.views[0, 0] == views


def test_fusion_without_agreement_is_the_mean_of_the_paper():
    fused = fuse_depths(stack(700, 710, NAN, 730), None)
    assert fused.depth_mm[0, 0] == pytest.approx(713.3333, abs=1e-3)
    assert fused.views[0, 0] == 3
    assert fused.scatter_mm2[0, 0] == pytest.approx(466.667, rel=1e-5)


@given(seeds, st.integers(1, 7))
def test_fusion_does_not_depend_on_the_order_of_the_pairs(seed, count):
    rng = np.random.default_rng(seed)
    depths = rng.normal(700, 1.5, (count, 5, 70)).astype(np.float32)
    depths[rng.random(depths.shape) < 0.3] = np.nan
    one, other = fuse_depths(depths, AGREE), fuse_depths(depths[rng.permutation(count)], AGREE)
    np.testing.assert_array_equal(one.depth_mm, other.depth_mm)
    np.testing.assert_array_equal(one.views, other.views)


def test_fused_strips_have_no_seams():
    depths = np.full((2, 131, 3), 700, np.float32) + np.arange(131, dtype=np.float32)[:, None]
    np.testing.assert_array_equal(fuse_depths(depths, AGREE).depth_mm, depths[0])
