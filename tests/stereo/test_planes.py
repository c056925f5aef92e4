"""Replacement of NaN in planes."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.stereo.multiview.surface import fill_nan


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("strided", [False, True])
def test_fill_nan_replaces_nan_and_keeps_the_rest(dtype, strided):
    plane = np.arange(24, dtype=dtype).reshape(4, 6)
    plane[1, 2] = plane[3, 5] = np.nan
    given = plane[:, ::2] if strided else plane
    before = given.copy()
    found = fill_nan(given, -1.5)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, np.where(np.isnan(before), -1.5, before))
    np.testing.assert_array_equal(given, before)
