"""Refined features: initial confidence around, photo-consistency, and the planes of reliable pixels."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.stereo.multiview.features import compute_initial_confidence_features
from beltscape.stereo.multiview.frame import choose_windows
from beltscape.stereo.multiview.optimisation import LeastSquaresResult
from beltscape.stereo.multiview.photoconsistency import (
    PHOTOMETRIC_LIMIT,
    PhotoConsistencyModel,
    compute_photometric_features,
    estimate_gain,
)
from beltscape.stereo.multiview.refined_features import compute_reliability_features
from beltscape.stereo.multiview.surface import Surface, fit_slopes
from tests.stereo.scenes import (
    Scene,
    make_inputs,
    make_scene,
    mask_away_from_steps,
    mask_inner,
    patch,
    plane,
    with_scale,
)

STEP = (plane(760), patch(640, (-90, 90), (-130, 130)))


def compute_features(made: Scene, s: np.ndarray, confidence: np.ndarray) -> dict[str, np.ndarray]:
    """Return the features of a surface with the true slopes."""
    slopes = fit_slopes(made.s, load(), 1)
    surface = Surface(s.astype(np.float32), slopes.slope_u, slopes.slope_v)
    prepared, none = with_scale(made.prepared), np.zeros(s.shape, np.float32)
    inputs = make_inputs(prepared, LeastSquaresResult(surface, none, none, none.astype(np.uint8), none))
    gain = estimate_gain(surface.s, np.full(s.shape, 0.02), prepared, inputs.buffers)
    consistency = PhotoConsistencyModel(prepared, gain, inputs.buffers)
    levels = compute_photometric_features(surface, confidence, consistency)
    return dict(levels) | dict(compute_reliability_features(inputs, confidence))


def test_images_are_consistent_where_the_surface_is_right():
    made = make_scene(*STEP, noise=1.0)
    wrong = np.zeros(made.s.shape, bool)
    wrong[40:60, 50:70] = True
    uncertain = np.zeros(made.s.shape, np.float32)
    found = compute_features(made, np.where(wrong, made.s - 4, made.s), uncertain)
    right = mask_away_from_steps(made.s, 4) & mask_inner(made.s.shape, 8) & ~wrong
    for name in ("point mean", "cross mean", "cross least"):
        assert np.median(found[name][right]) < np.log(1.5)
        assert np.median(found[name][wrong]) > np.median(found[name][right]) + 1


def test_photo_consistency_is_evaluated_only_at_uncertain_pixels():
    made = make_scene(plane(), noise=1.0)
    accepted = np.full(made.s.shape, PHOTOMETRIC_LIMIT + 1, np.float32)
    found = compute_features(made, made.s, accepted)
    for name in ("point most", "cross mean", "visible views"):
        assert np.ptp(found[name][1:]) == 0
    half = accepted.copy()
    half[30:60] = 0
    mixed = compute_features(made, made.s, half)
    all_uncertain = compute_features(made, made.s, np.zeros_like(accepted))
    np.testing.assert_array_equal(mixed["cross mean"][30:60], all_uncertain["cross mean"][30:60])
    np.testing.assert_array_equal(mixed["cross mean"][60:], found["cross mean"][60:])


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_a_pixel_off_the_reliable_plane_has_its_offset_as_feature(slope):
    made = make_scene(plane(700, slope), noise=1.0)
    s = made.s.copy()
    s[50, 60] += 6
    confidence = np.full(s.shape, 6.0, np.float32)
    confidence[50, 60] = -6
    found = compute_features(made, s, confidence)
    inside = mask_inner(s.shape, 12)
    for name in ("offset from reliable planes within 7", "offset from reliable planes within 15"):
        assert found[name][50, 60] == pytest.approx(6, abs=0.3)
        others = np.abs(found[name])[inside]
        assert np.median(others) < 0.02
    weight = found["reliable weight within 7"]
    assert weight[50, 60] == pytest.approx(48 / 49, abs=0.02)


def test_features_are_finite_without_reliable_pixels():
    made = make_scene(plane(), noise=1.0)
    found = compute_features(made, made.s, np.full(made.s.shape, -9.0, np.float32))
    for name, plane_ in found.items():
        assert np.isfinite(plane_).all(), name


def test_initial_confidence_features_are_means_and_minimum_around():
    confidence = np.zeros((40, 50), np.float32)
    confidence[20, 25] = 7
    windows = choose_windows(1224)
    found = dict(compute_initial_confidence_features(confidence, windows))
    assert found["initial confidence within 3"][21, 26] == pytest.approx(7 / 9)
    assert found["initial confidence within 7"][23, 28] == pytest.approx(7 / 49)
    assert found["lowest initial confidence within 3"][20, 25] == 0
    np.testing.assert_array_equal(
        dict(compute_initial_confidence_features(100 + confidence, windows))["initial confidence"], 8
    )
