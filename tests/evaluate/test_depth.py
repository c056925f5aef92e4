"""Scores of a depth map: coverage, noise, bias, interior and regions."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.evaluate.depth_scores import compute_robust_sigma, interior_mask, score_depth


def depth_map(z: np.ndarray, sigma_mm: float = 0.1) -> DepthMap:
    ones = np.ones(z.shape, np.float32)
    return DepthMap(z.astype(np.float32), ones * np.float32(sigma_mm), ones.astype(np.uint8), ones)


def test_every_share_counts_what_it_says():
    truth = np.full((10, 10), 700.0)
    truth[0] = np.nan
    measured = np.full((10, 10), 700.0)
    measured[1] = np.nan  # 10 unmeasured of 90 true
    measured[2] += 0.5  # 10 within 1 mm only
    measured[3] += 3  # 10 wrong
    measured[4] -= 8  # 10 gross
    score = score_depth(depth_map(measured), truth)
    assert score.pixels == 90
    assert score.coverage == pytest.approx(80 / 90)
    assert score.within_1mm == pytest.approx(60 / 90)
    assert score.within_quarter_mm == pytest.approx(50 / 90)
    assert score.gross == pytest.approx(10 / 80)


def test_noise_and_bias_of_the_interior():
    rng = np.random.default_rng(2)
    truth = np.full((200, 200), 700.0)
    measured = truth + rng.normal(0.05, 0.2, truth.shape)
    score = score_depth(depth_map(measured, 0.16), truth)
    assert score.interior_bias_mm == pytest.approx(0.05, abs=0.01)
    assert score.interior_robust_sigma_mm == pytest.approx(0.2, rel=0.03)
    assert score.interior_median_mm == pytest.approx(0.139, rel=0.03)
    assert score.interior_p95_mm == pytest.approx(0.40, rel=0.03)
    assert score.sigma_ratio == pytest.approx(1.25, rel=0.03)
    assert score.interior_gross == 0


def test_errors_near_a_step_are_not_interior():
    truth = np.full((60, 60), 700.0)
    truth[:, 30:] = 650
    measured = truth.copy()
    measured[:, 25:35] += 9
    score = score_depth(depth_map(measured), truth)
    assert score.gross == pytest.approx(10 / 60)
    assert score.interior_gross == 0
    assert score.interior_p95_mm == 0


def test_a_steep_slope_is_no_step():
    slope = 700 + 3.0 * np.arange(50)[None, :] + np.zeros((50, 1))
    assert interior_mask(slope).all()
    slope[:, 25:] += 4
    inside = interior_mask(slope)
    assert not inside[:, 20:30].any()
    assert inside[:, :16].all()


def test_a_region_restricts():
    truth = np.full((10, 10), 700.0)
    measured = truth.copy()
    measured[5:] += 2
    region = np.zeros((10, 10), bool)
    region[:5] = True
    assert score_depth(depth_map(measured), truth, region).within_1mm == 1
    assert score_depth(depth_map(measured), truth).within_1mm == 0.5


def test_an_empty_region_has_no_numbers():
    truth = np.full((10, 10), np.nan)
    score = score_depth(depth_map(np.full((10, 10), 700.0)), truth)
    assert score.pixels == 0
    assert np.isnan([score.coverage, score.within_1mm, score.interior_median_mm, score.sigma_ratio]).all()


def test_outliers_do_not_move_the_robust_sigma():
    values = np.random.default_rng(0).normal(0, 2, 10_000)
    values[:1000] = 1e6
    assert compute_robust_sigma(values) == pytest.approx(2.0, rel=0.2)


def test_another_grid_is_refused():
    with pytest.raises(InputError, match="truth is"):
        score_depth(depth_map(np.zeros((4, 5))), np.zeros((5, 4)))
