"""Exposure and focus: sharpness falls with blur, wherever it is; histogram and brightness show the exposure."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.commissioning.optics import BINS, TILES, assess_optics, map_sharpness
from beltscape.files.json_text import to_plain

SHAPE = (240, 320)


def make_speckle(seed: int = 1) -> NDArray[np.float32]:
    """Return a grey image (H, W) float32, 0 … 1, of dots of about three pixels."""
    noise = np.random.default_rng(seed).normal(size=SHAPE).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.2)
    return (0.5 + 0.2 * smooth / smooth.std()).clip(0, 1).astype(np.float32)


def blur_by(image: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Return the image blurred by a Gaussian; of σ 0 as it is."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32) if sigma_px else image


def test_sharpness_falls_with_blur_and_does_not_depend_on_contrast():
    sharp = make_speckle()
    medians = [map_sharpness(blur_by(sharp, blur)).median for blur in (0, 1, 2, 4)]
    assert medians == sorted(medians, reverse=True)
    assert medians[3] < 0.6 * medians[0]
    weak = np.asarray(0.5 + 0.4 * (sharp - 0.5), np.float32)
    assert map_sharpness(weak).median == pytest.approx(medians[0], rel=0.01)


def test_a_corner_out_of_focus_is_found_where_it_is():
    sharp = make_speckle()
    half = sharp.copy()
    half[120:, 160:] = cv2.GaussianBlur(sharp, (0, 0), 3.0)[120:, 160:]
    found = map_sharpness(half)
    assert found.values.shape == TILES[::-1]
    row, column = np.unravel_index(np.nanargmin(found.values), found.values.shape)
    assert row >= TILES[1] // 2
    assert column >= TILES[0] // 2
    assert found.evenness < 0.6 < map_sharpness(sharp).evenness


def test_the_standard_deviation_is_that_of_repeated_images():
    """Compare the stated σ of a tile with the scatter of its sharpness over other dots of the same kind."""
    maps = [map_sharpness(make_speckle(seed)) for seed in range(12)]
    scatter = np.stack([one.values for one in maps]).std(axis=0, ddof=1)
    stated = np.sqrt(np.square(np.stack([one.sigmas for one in maps])).mean(axis=0))
    assert np.median(stated / scatter) == pytest.approx(1.0, abs=0.35)


def test_an_image_without_texture_has_no_sharpness():
    grey = np.random.default_rng(0).normal(0.5, 0.003, SHAPE).astype(np.float32)
    found = map_sharpness(grey)
    assert np.isnan(found.values).all()
    assert np.isnan(found.median)


def test_histogram_and_brightness():
    image = np.rint(255 * make_speckle()).astype(np.uint8)
    report = assess_optics(image)
    assert report.histogram.shape == (BINS,)
    assert int(report.histogram.sum()) == image[::2, ::2].size
    assert report.fault == ""
    assert assess_optics(np.full_like(image, 255)).document()["fault"] == "overexposed"
    assert assess_optics(np.zeros_like(image)).document()["fault"] == "dark"
    plain = to_plain(assess_optics(np.full_like(image, 128)).document())
    assert plain["sharpness"][0][0] is None
