"""Inflation of sigma by correlated noise, estimated from the disagreement of the views."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.stereo.multiview.correlated_noise import Inflation, estimate_inflation
from beltscape.stereo.multiview.frame import Noise
from beltscape.stereo.multiview.surface import compute_inverse_depth_scale, detect_depth_steps
from tests.stereo.scenes import (
    Scene,
    compute_depth_mm,
    make_ring,
    plane,
    prepare_scene,
    quantise,
    render_images,
    with_context,
)

NOISE = 4.0
SOLID = plane(700, 0.2, 0.1)
BLURS_PX = (0.5, 0.65, 0.8)


def make_noisy_scene(blur_px: float, angles=(0, 90, 180, 270), seed: int = 2) -> Scene:
    """Return a frame with noise of one variance, white or correlated over ``blur_px``."""
    rig = make_ring(angles, size_px=(320, 256))
    rng = np.random.default_rng(seed)
    images = {
        name: quantise(image + NOISE * correlate_noise(rng.standard_normal(image.shape), blur_px), np.uint16)
        for name, image in render_images(rig, (SOLID,), dot_px=2.0).items()
    }
    prepared = prepare_scene(rig, FrameSet("000", images))
    noise = Noise(NOISE**2, 1e-4, prepared.noise.texture)
    unit = compute_inverse_depth_scale(rig, rig.auxiliaries)
    s = (1 / (compute_depth_mm(rig, (SOLID,)) * unit)).astype(np.float32)
    return Scene(rig, replace(prepared, noise=noise), s, unit)


def correlate_noise(white: np.ndarray, blur_px: float) -> np.ndarray:
    """Return correlated noise of the same variance."""
    if blur_px == 0:
        return white
    blurred = cv2.GaussianBlur(white, (0, 0), blur_px)
    return blurred / blurred.std()


def estimate(made: Scene, threads: int = 1) -> Inflation:
    return estimate_inflation(
        made.s, detect_depth_steps(made.s), with_context(made.prepared, threads=threads)
    )


def predict_inflation(made: Scene, blur_px: float) -> float:
    """Return the sum over lags of the noise's times the texture's autocorrelation: the variance factor of pulls."""
    core = np.nan_to_num(made.prepared.core)
    slopes = [np.diff(core, axis=axis)[8:-8, 8:-8] for axis in (0, 1)]
    kernel = np.zeros((33, 33))
    kernel[16, 16] = 1
    kernel = cv2.GaussianBlur(cv2.GaussianBlur(kernel, (0, 0), blur_px), (0, 0), blur_px)
    ratios = [float((g * cv2.filter2D(g, -1, kernel / kernel[16, 16])).sum() / (g * g).sum()) for g in slopes]
    return float(np.mean(ratios))


@pytest.mark.parametrize("seed", [2, 3])
def test_inflation_by_white_noise_is_that_of_the_shared_core(seed):
    assert 0.7 < estimate(make_noisy_scene(0, seed=seed)).overall < 1.7


@pytest.mark.parametrize("blur_px", BLURS_PX)
def test_inflation_by_correlated_noise_is_the_sum_of_its_correlation(blur_px):
    made = make_noisy_scene(blur_px)
    ratio = estimate(made).overall / estimate(make_noisy_scene(0)).overall
    assert predict_inflation(made, blur_px) > 1.3
    # normalising levels in windows removes the longest part of the correlation
    assert 0.55 < ratio / predict_inflation(made, blur_px) < 1.3


def test_smooth_calibration_errors_do_not_inflate():
    made = make_noisy_scene(0)
    before = estimate(made).overall
    views = made.prepared.views.copy()
    views[0, 9:12] *= 1.002  # the factor of s for one auxiliary: its baseline
    displaced = replace(made, prepared=replace(made.prepared, views=views))
    assert estimate(displaced).overall < 1.3 * before


def test_single_auxiliary_has_no_inflation_estimate():
    found = estimate(make_noisy_scene(0.8, angles=(0,)))
    assert not len(found.ratio)
    assert np.isnan(found.overall)


def test_inflation_does_not_depend_on_the_number_of_threads():
    made = make_noisy_scene(0.8)
    one, three = estimate(made, 1), estimate(made, 3)
    assert one.ratio.tobytes() == three.ratio.tobytes()


def test_missing_surface_has_no_inflation_estimate():
    made = make_noisy_scene(0)
    nothing = replace(made, s=np.full_like(made.s, np.nan))
    assert not len(estimate(nothing).ratio)
