"""Contrast and levels of images: each level has the bits of NumPy's sums."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from tests.kernels.grids import WIDTHS
from tests.kernels.rounding import emulated
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", (*levels(), *emulated()))
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
sizes = st.sampled_from((*WIDTHS, 130, 203))
types = st.sampled_from((np.uint8, np.uint16))


def random_image(seed: int, shape: tuple[int, int], kind: type[np.unsignedinteger]) -> np.ndarray:
    """Return an image that fills a random part of its type's range."""
    rng = np.random.default_rng(seed)
    low, high = sorted(rng.integers(0, int(np.iinfo(kind).max) + 2, 2))
    return rng.integers(low, max(high, low + 1), shape).clip(0, np.iinfo(kind).max).astype(kind)


@every_level
@given(seeds, sizes, sizes, types)
def test_contrast_has_the_bits_of_numpys(level, seed, height, width, kind):
    image = random_image(seed, (height, width), kind)
    found, expected = (load(name).measure_contrast(image) for name in (level, "reference"))
    assert found.shape == ()
    assert found.dtype == np.float32
    assert found.tobytes() == expected.tobytes()


@pytest.mark.parametrize(
    "shape", [(1, 128), (1, 129), (1, 137), (16, 16), (360, 481), (511, 257), (600, 700)]
)
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_the_halves_are_added_up_as_numpy_does(shape, kind):
    image = random_image(1, shape, kind)
    level = image.astype(np.float32) * np.float32(255 / np.iinfo(kind).max)
    for name in (*levels(), *emulated()[:1]):
        assert load(name).measure_contrast(image).tobytes() == level.std().tobytes()


@every_level
@given(seeds, sizes, sizes, types, st.floats(0.5, 2), st.integers(1, 3))
def test_levels_are_those_of_the_reference(level, seed, height, width, kind, gain, threads):
    image = random_image(seed, (height, width), kind)
    found = load(level).make_levels(image, gain, threads=threads)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, load("reference").make_levels(image, gain))


@everything
def test_both_types_have_one_range(name):
    kernels = load(name)
    bytes_, words = np.array([[0, 7, 255]], np.uint8), np.array([[0, 7 * 257, 65535]], np.uint16)
    np.testing.assert_allclose(kernels.make_levels(bytes_, 1.0), [[0, 7, 255]])
    np.testing.assert_allclose(kernels.make_levels(words, 1.0), [[0, 7, 255]], rtol=1e-6)
    assert float(kernels.measure_contrast(np.full((3, 50), 9, np.uint16))) == 0


@everything
def test_an_image_that_is_not_contiguous_is_read_as_it_lies(name):
    image = random_image(3, (40, 60), np.uint8)
    part = image[::2, 1::3]
    np.testing.assert_array_equal(load(name).make_levels(part, 2.0), 2.0 * part)


@everything
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda k: k.measure_contrast(np.zeros((3, 4))),
            "image must be uint8 or uint16 (H, W), not float64 (3, 4)",
        ),
        (
            lambda k: k.measure_contrast(np.zeros((0, 4), np.uint8)),
            "uint8 or uint16 (H, W), not uint8 (0, 4)",
        ),
        (lambda k: k.make_levels(np.zeros((3, 4, 3), np.uint8), 1.0), "(H, W), not uint8 (3, 4, 3)"),
        (lambda k: k.make_levels(np.zeros((3, 4), np.uint8), 0.0), "gain must be positive, not 0"),
    ],
)
def test_input_that_does_not_fit_is_refused(name, call, message):
    with pytest.raises(KernelError) as error:
        call(load(name))
    assert message in str(error.value)
