"""Defocus of the core: its estimate, and the blur of the auxiliaries that matches it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.stereo.multiview.photometry import estimate_defocus, match_defocus
from tests.strategies import seeds
from tests.thorough import examples


def make_dots(seed: int, noise: float = 1.5) -> np.ndarray:
    """Return a (200, 320) image of speckle."""
    rng = np.random.default_rng(seed)
    image = np.zeros((200, 320), np.float32)
    image[rng.integers(0, 200, 1500), rng.integers(0, 320, 1500)] = 2500
    return cv2.GaussianBlur(image, (0, 0), 1.2) + 20 + rng.normal(0, noise, image.shape).astype(np.float32)


def blur(image: np.ndarray, sigma_px: float) -> np.ndarray:
    noise = np.random.default_rng(9).normal(0, 1.5, image.shape).astype(np.float32)
    return cv2.GaussianBlur(image, (0, 0), sigma_px) + noise


@examples(10)
@given(seeds, st.floats(1.8, 3.2))
def test_defocus_is_estimated(seed, sigma_px):
    core = blur(make_dots(seed, 0), sigma_px)
    assert estimate_defocus(core, [make_dots(seed + i) for i in (1, 2, 3)]) == pytest.approx(
        sigma_px, abs=0.5
    )


@examples(10)
@given(seeds)
def test_sharp_frames_and_blurred_auxiliaries_are_unchanged(seed):
    levels = {
        "core": make_dots(seed),
        "a": make_dots(seed + 1),
        "b": blur(make_dots(seed + 2), 2.5),
        "c": make_dots(seed + 3),
    }
    after = match_defocus("core", levels)
    assert all(after[name] is levels[name] for name in levels)


def test_only_the_auxiliaries_are_blurred_and_not_beyond_the_core():
    levels = {"core": blur(make_dots(1, 0), 3.0), "a": make_dots(2), "b": make_dots(3)}
    after = match_defocus("core", levels)
    assert after["core"] is levels["core"]
    for name in ("a", "b"):
        assert after["core"].std() < after[name].std() < levels[name].std()


@pytest.mark.parametrize("image", [np.zeros((40, 60), np.float32), np.full((5, 7), 90, np.float32)])
def test_images_without_texture_stay_finite(image):
    after = match_defocus("core", {"core": image, "a": image.copy()})
    assert all(np.isfinite(level).all() for level in after.values())
