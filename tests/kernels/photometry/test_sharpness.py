"""Sharpness and the phases of demosaicing: each level agrees with the reference, and the reference with OpenCV."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from beltscape.kernels.photometry import choose_radius, weigh_window
from tests.kernels.grids import WIDTHS
from tests.kernels.rounding import emulated, first_alike
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", (*levels(), *emulated()))
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
sizes = st.sampled_from(WIDTHS)
blurs = st.sampled_from([(0.0, 1.0, 3.0), (1.5, 1.8, 3.4), (0.0, 0.0, 0.5), (4.0, 4.1, 5.0), (2.0, 6.0, 6.0)])


def random_image(seed: int, height: int, width: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (height, width)).astype(np.float32)


@every_level
@given(seeds, sizes, sizes, blurs, st.integers(1, 3))
def test_sharpness_is_that_of_the_reference(level, seed, height, width, sigmas_px, threads):
    image = random_image(seed, height, width)
    found = load(level).measure_sharpness(image, sigmas_px, threads=threads)
    np.testing.assert_allclose(
        found, load("reference").measure_sharpness(image, sigmas_px), rtol=2e-3, atol=1e-6
    )


@every_level
@given(seeds, sizes, sizes, blurs)
def test_levels_with_the_same_rounding_give_the_same_bytes(level, seed, height, width, sigmas_px):
    image = random_image(seed, height, width)
    found, expected = (load(k).measure_sharpness(image, sigmas_px) for k in (level, first_alike(level)))
    assert found.tobytes() == expected.tobytes()


@given(seeds, blurs)
def test_the_reference_blurs_as_opencv_does(seed, sigmas_px):
    image = random_image(seed, 70, 90)
    blurred = [cv2.GaussianBlur(image, (0, 0), s) if s else image for s in sigmas_px]
    expected = [np.var(one - other) for one, other in pairwise(blurred)]
    np.testing.assert_allclose(
        load("reference").measure_sharpness(image, sigmas_px), expected, rtol=1e-3, atol=1e-6
    )


def test_windows_are_those_of_opencv():
    for sigma in (0.5, 1.0, 1.5, 1.8, 3.35, 5.0):
        expected = cv2.getGaussianKernel(2 * choose_radius(sigma) + 1, sigma).ravel()
        np.testing.assert_allclose(
            weigh_window(choose_radius(sigma), sigma), expected[choose_radius(sigma) :]
        )
    assert choose_radius(0) == 0


@pytest.mark.parametrize("name", ["reference", *emulated()])
@given(seeds, sizes.filter(lambda n: n > 1), sizes.filter(lambda n: n > 1))
def test_phases_are_means_of_second_differences(name, seed, height, width):
    image = random_image(seed, height, width)
    around = np.pad(image.astype(float), 1, mode="reflect")
    second = (
        4 * around[1:-1, 1:-1] - around[:-2, 1:-1] - around[2:, 1:-1] - around[1:-1, :-2] - around[1:-1, 2:]
    )
    whole = np.abs(second)[: height // 2 * 2, : width // 2 * 2]
    expected = [whole[y::2, x::2].mean() for y in (0, 1) for x in (0, 1)]
    np.testing.assert_allclose(load(name).measure_phases(image), expected, rtol=1e-5, atol=1e-4)


@everything
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda k: k.measure_sharpness(np.ones((5, 5)), (1.0, 2.0)),
            "sigmas_px must be three from 0 to 6, ascending",
        ),
        (lambda k: k.measure_sharpness(np.ones((5, 5)), (2.0, 1.0, 3.0)), "ascending, not [2.0, 1.0, 3.0]"),
        (lambda k: k.measure_sharpness(np.ones((5, 5)), (1.0, 2.0, 7.0)), "ascending, not [1.0, 2.0, 7.0]"),
        (
            lambda k: k.measure_sharpness(np.ones(5), (1.0, 2.0, 3.0)),
            "image must have the shape (H, W), not (5,)",
        ),
        (lambda k: k.measure_phases(np.ones((1, 5))), "image must be of at least 2 × 2 pixels, not (1, 5)"),
    ],
)
def test_input_that_does_not_fit_is_refused(name, call, message):
    with pytest.raises(KernelError) as error:
        call(load(name))
    assert message in str(error.value)
