"""What a closer look adds: impressions around, levels that are alike where the surface is right, and the trusted."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import Scene, away_from_steps, inner, patch, plane, scene

from beltscape.kernels import load
from beltscape.stereo.multiview.confidence.refined_features import (
    PHOTOMETRIC_LIMIT,
    initial_confidence_features,
    photometric_features,
    reliability_features,
)
from beltscape.stereo.multiview.frame.surface import Surface, fit_slopes
from beltscape.stereo.multiview.frame.visibility import compute_visibility
from beltscape.stereo.multiview.selection.gain import estimate_gain
from beltscape.stereo.multiview.selection.photoconsistency import PhotoConsistencyModel

STEP = (plane(760), patch(640, (-90, 90), (-130, 130)))


def looked(made: Scene, s: np.ndarray, impression: np.ndarray) -> dict[str, np.ndarray]:
    """Evidence of a surface with the true slopes."""
    slopes = fit_slopes(made.s, load(), 1)
    surface = Surface(s.astype(np.float32), slopes.slope_u, slopes.slope_v)
    prepared = made.prepared
    _, buffers = compute_visibility(surface.s, prepared.views, prepared.sizes, load(), 1)
    light = estimate_gain(surface.s, np.full(s.shape, 0.02), prepared, buffers, 1.0, load(), 1)
    levels = photometric_features(
        surface, impression, PhotoConsistencyModel(prepared, light, buffers, load()), 1
    )
    return dict(levels) | dict(reliability_features(surface, impression, 1.0))


def test_the_levels_are_alike_where_the_surface_is_right():
    made = scene(*STEP, noise=1.0)
    wrong = np.zeros(made.s.shape, bool)
    wrong[40:60, 50:70] = True
    doubt = np.zeros(made.s.shape, np.float32)
    found = looked(made, np.where(wrong, made.s - 4, made.s), doubt)
    right = away_from_steps(made.s, 4) & inner(made.s.shape, 8) & ~wrong
    for name in ("point mean", "cross mean", "cross least"):
        assert np.median(found[name][right]) < np.log(1.5)
        assert np.median(found[name][wrong]) > np.median(found[name][right]) + 1


def test_nobody_asks_the_levels_where_there_is_no_doubt():
    made = scene(plane(), noise=1.0)
    sure = np.full(made.s.shape, PHOTOMETRIC_LIMIT + 1, np.float32)
    found = looked(made, made.s, sure)
    for name in ("point most", "cross mean", "seen by"):
        assert np.ptp(found[name][1:]) == 0
    half = sure.copy()
    half[30:60] = 0
    mixed = looked(made, made.s, half)
    everybody = looked(made, made.s, np.zeros_like(sure))
    np.testing.assert_array_equal(mixed["cross mean"][30:60], everybody["cross mean"][30:60])
    np.testing.assert_array_equal(mixed["cross mean"][60:], found["cross mean"][60:])


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_the_trusted_tell_a_pixel_that_left_their_plane(slope):
    made = scene(plane(700, slope), noise=1.0)
    s = made.s.copy()
    s[50, 60] += 6
    impression = np.full(s.shape, 6.0, np.float32)
    impression[50, 60] = -6
    found = looked(made, s, impression)
    inside = inner(s.shape, 12)
    for name in ("off the trusted within 7", "off the trusted within 15"):
        assert found[name][50, 60] == pytest.approx(6, abs=0.3)
        others = np.abs(found[name])[inside]
        assert np.median(others) < 0.02
    trust = found["trust within 7"]
    assert trust[50, 60] == pytest.approx(48 / 49, abs=0.02)


def test_nobody_trusted_says_nothing_that_is_not_finite():
    made = scene(plane(), noise=1.0)
    found = looked(made, made.s, np.full(made.s.shape, -9.0, np.float32))
    for name, plane_ in found.items():
        assert np.isfinite(plane_).all(), name


def test_impressions_are_those_of_the_surroundings():
    impression = np.zeros((40, 50), np.float32)
    impression[20, 25] = 7
    found = dict(initial_confidence_features(impression, 1.0))
    assert found["impression within 3"][21, 26] == pytest.approx(7 / 9)
    assert found["impression within 7"][23, 28] == pytest.approx(7 / 49)
    assert found["worst impression within 3"][20, 25] == 0
    np.testing.assert_array_equal(dict(initial_confidence_features(100 + impression, 1.0))["impression"], 8)
