"""Gathering: each level equals the reference; input that does not fit is refused."""

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
sizes = st.sampled_from(WIDTHS)


@every_level
@given(seeds, sizes, sizes, st.integers(1, 3), st.integers(1, 40), st.integers(1, 5), st.integers(1, 3))
def test_native_is_the_reference(level, seed, height, width, count, pixels, moves, threads):
    rng = np.random.default_rng(seed)
    planes = list(rng.normal(size=(count, height, width)).astype(np.float32))
    planes[0][rng.random((height, width)) < 0.1] = np.nan
    u, v = rng.integers(0, width, pixels), rng.integers(0, height, pixels)
    offsets = rng.integers(-2 * width, 2 * width, (moves, 2))
    expected = load("reference").gather(planes, u, v, offsets)
    found = load(level).gather(planes, u, v, offsets, threads=threads)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, expected)


@everything
def test_beyond_the_edge_it_is_repeated(name):
    plane = np.arange(12.0).reshape(3, 4)
    found = load(name).gather(
        [plane, -plane], np.array([3]), np.array([1]), np.array([[0, 0], [2, 0], [-1, -9]])
    )
    assert found[..., 0].tolist() == [[7, 7, 2], [-7, -7, -2]]


@everything
@pytest.mark.parametrize(
    ("planes", "u", "offsets", "message"),
    [
        ([], [0], np.zeros((1, 2), int), "planes must be at least one"),
        ([(3, 4), (4, 3)], [0], np.zeros((1, 2), int), r"planes\[1\] must have the shape \(3, 4\)"),
        ([(3, 4)], [4], np.zeros((1, 2), int), "u must be 0 to 3, not 4 to 4"),
        ([(3, 4)], [0], np.zeros((1, 3), int), r"offsets must be \(K, 2\) integers, not int64 \(1, 3\)"),
        ([(3, 4)], [0], np.zeros((1, 2)), r"offsets must be \(K, 2\) integers, not float64"),
    ],
)
def test_what_does_not_fit_is_refused(name, planes, u, offsets, message):
    with pytest.raises(KernelError, match=message):
        load(name).gather([np.zeros(shape) for shape in planes], np.array(u), np.zeros(1, int), offsets)
