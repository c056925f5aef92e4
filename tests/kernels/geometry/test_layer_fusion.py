"""Fusion of layers: each level equals the reference, and single cells have known results."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.geometry import FusedLayers
from beltscape.kernels.native import levels
from tests.kernels.grids import WIDTHS
from tests.strategies import seeds

everything = pytest.mark.parametrize("name", ["reference", *levels()])
lengths = st.sampled_from(WIDTHS[:-2])
Planes = tuple[np.ndarray, np.ndarray, np.ndarray]


def fuse_layers(name: str, planes: Planes, *, tolerance: float = 0.35, threads: int = 0) -> FusedLayers:
    """Fuse by the limits of the flow's measurement."""
    return load(name).fuse_layers(planes, rank=0.65, outlier=4.0, tolerance=tolerance, threads=threads)


def make_layers(seed: int, shape: tuple[int, int, int], holes: float) -> Planes:
    """Layers of one surface with noise, holes, and values of another surface; float32."""
    rng = np.random.default_rng(seed)
    surface = np.cumsum(rng.normal(size=shape[1:]), axis=1)
    sigma = rng.uniform(0.05, 0.5, shape)
    height = surface + sigma * rng.normal(size=shape) + 20 * (rng.random(shape) < 0.1)
    height[rng.random(shape) < holes] = np.nan
    lost = np.isnan(height)
    sigma[lost] = np.nan
    return height.astype(np.float32), sigma.astype(np.float32), (0.3 * sigma).astype(np.float32)


def fuse(name: str, values: list[float], sigma: float = 0.1) -> FusedLayers:
    """Fuse layers of one cell."""
    height = np.array(values, np.float32)[:, None, None]
    return fuse_layers(name, (height, np.full_like(height, sigma), np.full_like(height, 0.0)))


@pytest.mark.parametrize("level", levels())
@given(seeds, st.integers(1, 7), lengths, lengths, st.sampled_from([0.0, 0.3, 0.9, 1.0]))
def test_native_is_the_reference(level, seed, layers, height, width, holes):
    planes = make_layers(seed, (layers, height, width), holes)
    found = fuse_layers(level, planes, threads=2)
    expected = fuse_layers("reference", planes)
    for name in ("height", "sigma", "noise"):
        one, other = getattr(found, name), getattr(expected, name)
        assert one.dtype == other.dtype == np.float32
        np.testing.assert_allclose(one, other, rtol=1e-6)
    assert np.array_equal(found.measured, expected.measured)
    assert np.array_equal(found.sums[:, [0, 4]], expected.sums[:, [0, 4]])
    np.testing.assert_allclose(found.sums, expected.sums, rtol=1e-5, atol=1e-6)


@everything
def test_what_differs_from_the_middle_is_left_out(name):
    found = fuse(name, [5.0, 5.2, 9.0, np.nan])
    assert found.height[0, 0] == pytest.approx(5.1)
    assert found.sigma[0, 0] == pytest.approx(0.1 / np.sqrt(2))
    # two values, each 0.1 from the mean of which it is a half, and one outlier
    assert found.sums[0] == pytest.approx([2, 0.04, 0.02, 1.0, 1.0], rel=1e-5)


@everything
def test_nothing_measured_stays_nothing(name):
    found = fuse(name, [np.nan, np.nan])
    assert np.isnan([found.height, found.sigma, found.noise]).all()
    assert not found.measured.any()
    assert not found.sums.any()


@everything
def test_a_steep_surface_may_be_displaced(name):
    steps = np.arange(6, dtype=np.float32) * 10
    height = np.stack([np.tile(steps, (3, 1)), np.tile(steps + 3, (3, 1))])
    sigma = np.full_like(height, 0.1)
    assert not fuse_layers(name, (height, sigma, sigma)).sums[:, 4].any()
    assert fuse_layers(name, (height, sigma, sigma), tolerance=0.0).sums[:, 4].tolist() == [6, 6, 6]


@pytest.mark.parametrize("level", levels())
def test_any_number_of_threads_gives_the_same_bytes(level):
    planes = make_layers(1, (5, 90, 700), 0.4)
    runs = [fuse_layers(level, planes, threads=threads) for threads in (1, 2, 5)]
    for run in runs[1:]:
        assert [part.tobytes() for part in run] == [part.tobytes() for part in runs[0]]


@everything
def test_planes_of_different_shapes_are_refused(name):
    height = np.zeros((2, 3, 4), np.float32)
    with pytest.raises(KernelError, match="sigma"):
        fuse_layers(name, (height, height[:1], height))
