"""Windows with weights and numbers of whole planes: the emulated GPU agrees with OpenCV and NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import Kernels, load
from beltscape.kernels.native import levels
from beltscape.kernels.resident import ResidentArray
from beltscape.kernels.statistics import find_statistics_kernels
from tests.kernels.grids import WIDTHS
from tests.kernels.planes.test_expressions import plane as special_plane
from tests.kernels.planes.test_expressions import resident
from tests.kernels.planes.test_windows import every, plane
from tests.strategies import seeds

sizes = st.sampled_from(WIDTHS)
shares = st.sampled_from((0.0, 0.25, 0.5, 0.9, 0.99, 1.0))


@every
@given(seeds, sizes, sizes, st.sampled_from((1, 3, 9)), st.sampled_from((1, 3, 7)), st.booleans())
def test_weighted_windows_are_opencvs(name, seed, height, width, columns, rows, repeat):
    values = plane(seed, height, width)
    weights = np.random.default_rng(seed).normal(0, 1, (rows, columns)).astype(np.float32)
    found, expected = (
        k.filter_plane(values, weights, repeat_edge=repeat) for k in (load(name), load("reference"))
    )
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=1e-5 * 200 * np.abs(weights).sum())


@every
@given(seeds, sizes, sizes, shares)
def test_quantiles_are_numpys_over_all_arrays_without_nan(name, seed, height, width, share):
    arrays = [special_plane(seed, (height, width)), plane(seed, 1, width)]
    arrays[0][np.isinf(arrays[0])] = -0.0
    numbers = np.concatenate([each.ravel() for each in arrays])
    expected = np.quantile(numbers[~np.isnan(numbers)], share)
    found = load(name).find_quantile(arrays, share)
    assert found.shape == ()
    np.testing.assert_array_equal(found, expected)


@every
def test_quantiles_of_nothing_and_of_equal_numbers(name):
    kernels = load(name)
    assert np.isnan(kernels.find_quantile([np.full((3, 4), np.nan, np.float32)], 0.5))
    same = np.full((40, 30), -7.25, np.float32)
    assert [float(kernels.find_quantile([same], share)) for share in (0, 0.3, 1)] == [-7.25] * 3
    ordered = np.array([[1, 2, 4, np.inf]], np.float32)
    assert float(kernels.find_quantile([ordered[:, ::-1].copy()], 0.5)) == 3.0


@every
@given(seeds, sizes, sizes)
def test_the_mean_is_that_of_finite_numbers(name, seed, height, width):
    values = special_plane(seed, (height, width))
    finite = values[np.isfinite(values)]
    expected = finite.mean(dtype=np.float64) if finite.size else 0
    np.testing.assert_allclose(load(name).average_plane(values), expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda k: k.filter_plane(np.ones((5, 5)), np.ones((2, 3))),
            "weights must have odd sides, not (2, 3)",
        ),
        (lambda k: k.find_quantile([], 0.5), "a quantile needs at least one array"),
        (lambda k: k.find_quantile([np.ones(3)], 1.5), "share must be at least 0 and at most 1, not 1.5"),
        (lambda k: k.average_plane(np.ones(3)), "plane must have the shape (H, W), not (3,)"),
    ],
)
def test_input_that_does_not_fit_is_refused(call, message):
    with pytest.raises(KernelError) as refused:
        call(load(levels()[-1]))
    assert str(refused.value) == message


def test_numbers_of_a_plane_stay_on_the_device_and_are_used_there():
    kernels, backend = resident()
    values = plane(3, 20, 30)
    kept = kernels.keep(values)
    on_device = find_statistics_kernels(kept)
    assert on_device is not None
    middle = on_device.find_quantile([kept], 0.5)
    above = np.where(kept > middle * 2, kept, np.float32(0))
    assert isinstance(above, ResidentArray)
    assert backend.traffic.downloads == 0
    np.testing.assert_array_equal(above, np.where(values > np.median(values) * 2, values, np.float32(0)))
    assert float(middle) == np.median(values)
    assert find_statistics_kernels(values) is None
    assert isinstance(kernels, Kernels)
