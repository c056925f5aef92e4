"""Correction of SGBM's rounding, and sampling of its disparities."""

from __future__ import annotations

import numpy as np

from beltscape.stereo.pairwise.sgbm import correct_bias, sample_values


def round_like_opencv(whole: int, offset: np.ndarray) -> np.ndarray:
    """Return SGBM's fixed-point result: offset = num/(2·den) px, (num·16 + den) / (2·den) truncated."""
    den = 10_000
    num = np.rint(offset * 2 * den).astype(np.int64)
    return (whole * 16 + np.trunc((num * 16 + den) / (2 * den))).astype(np.int16)


def test_correction_removes_the_bias_of_opencvs_rounding():
    offset = np.random.default_rng(0).uniform(-0.5, 0.5, 200_000)
    raw = round_like_opencv(20, offset)
    assert np.mean(raw / 16 - 20 - offset) > 0.014  # the bias to correct
    assert abs(np.mean(correct_bias(raw) - 20 - offset)) < 0.001
    for half in (offset < -0.05, offset > 0.05):
        assert abs(np.mean((correct_bias(raw) - 20 - offset)[half])) < 0.004


def test_negative_disparities_become_nan():
    assert np.isnan(correct_bias(np.array([-16, -1], np.int16))).all()


def test_sampling_does_not_interpolate_across_steps():
    values = np.tile(np.array([10, 10, 10, 30, 30, 30], np.float32), (4, 1))
    u = np.linspace(0.5, 4.5, 41, dtype=np.float32)
    source = np.stack([u, np.full_like(u, 1.5)], axis=-1)[None]
    assert set(np.unique(sample_values(values, source))) == {10, 30}


def test_sampling_is_bilinear_on_a_slope_and_keeps_gaps():
    values = np.tile(np.linspace(0, 1.75, 8, dtype=np.float32), (4, 1))
    values[:, 6] = np.nan
    u = np.array([0.25, 2.5, 4.75, 6.1], np.float32)
    source = np.stack([u, np.full_like(u, 2.0)], axis=-1)[None]
    sampled = sample_values(values, source)[0]
    np.testing.assert_allclose(sampled[:3], u[:3] / 4, atol=0.01)
    assert np.isnan(sampled[3])
