"""Medians and quantiles: to the bit those of NumPy, for any count, type and shape; and what is none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.statistics import compute_median, compute_quantile, drop_nan

counts = st.integers(1, 400)
seeds = st.integers(0, 2**32 - 1)
types = st.sampled_from([np.float32, np.float64])


def _draw(seed: int, count: int, kind: type) -> np.ndarray:
    """Return numbers of very different sizes, some of them equal."""
    generator = np.random.default_rng(seed)
    values = generator.normal(size=count) * 10 ** generator.uniform(-3, 3, count)
    values[generator.random(count) < 0.2] = values[0]
    return values.astype(kind)


@given(seeds, counts, types)
def test_the_median_is_that_of_numpy(seed, count, kind):
    """Even and odd counts."""
    values = _draw(seed, count, kind)
    before = values.copy()
    assert compute_median(values) == float(np.median(values))
    assert np.array_equal(values, before)


@given(seeds, counts, types, st.floats(0, 1))
def test_a_quantile_is_that_of_numpy(seed, count, kind, share):
    """The ends are the least and the largest value."""
    values = _draw(seed, count, kind)
    assert compute_quantile(values, share) == float(np.quantile(values, share))
    assert compute_quantile(values, 0.0) == values.min()
    assert compute_quantile(values, 1.0) == values.max()


def test_a_plane_counts_as_its_values():
    """The shape does not matter, nor whether the memory is contiguous."""
    plane = _draw(1, 600, np.float32).reshape(20, 30)
    assert compute_median(plane) == float(np.median(plane))
    assert compute_median(plane[::3, ::2]) == float(np.median(plane[::3, ::2]))
    assert compute_quantile(plane[::3, ::2], 0.33) == float(np.quantile(plane[::3, ::2], 0.33))


@pytest.mark.parametrize("place", [0, 3, 8])
@pytest.mark.parametrize("share", [0.0, 0.4, 0.5, 1.0])
def test_nan_is_not_passed_over(place, share):
    """As by NumPy; also where NaN are sorted far from the rank that is selected."""
    values = np.arange(9, dtype=np.float32)
    values[place] = np.nan
    assert np.isnan(compute_median(values))
    assert np.isnan(compute_quantile(values, share))


def test_there_is_none_of_no_values():
    """Without a warning: callers decide what that means."""
    assert np.isnan(compute_median(np.empty(0)))
    assert np.isnan(compute_quantile(np.empty((0, 3), np.float32), 0.5))


@given(seeds, counts, types)
def test_without_nan_the_median_is_that_of_the_rest(seed, count, kind):
    """Of an array of any shape; of nothing but NaN there is none."""
    values = _draw(seed, count, kind)
    values[1::3] = np.nan
    plane = np.stack([values, values])
    assert compute_median(drop_nan(plane)) == float(np.nanmedian(plane))
    assert np.isnan(compute_median(drop_nan(np.full((2, 3), np.nan, kind))))
