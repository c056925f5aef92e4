"""Compression of cross-sections."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from beltscape.sinks.historian.records import STEP_MM, pack_heights, round_heights, unpack_heights
from tests.sinks.ledgers import section

heights = arrays(
    np.float32,
    st.integers(0, 300),
    elements=st.one_of(st.just(np.nan), st.floats(-3000, 3000, width=32)),
)


@given(heights)
def test_heights_read_back_to_half_a_step(height):
    back = unpack_heights(pack_heights(height))
    assert back.dtype == np.float32
    assert np.array_equal(np.isnan(back), np.isnan(height))
    assert np.all(np.abs(back - height)[~np.isnan(height)] <= STEP_MM / 2)


@given(heights)
def test_second_round_trip_changes_nothing(height):
    once = unpack_heights(pack_heights(height))
    assert np.array_equal(once, round_heights(height), equal_nan=True)
    assert pack_heights(once) == pack_heights(height)


def test_a_section_takes_two_fifths_of_its_floats():
    height = section(3).height_mm
    assert len(pack_heights(height)) < 0.4 * height.nbytes


def test_truncated_bytes_are_refused():
    data = pack_heights(section(3).height_mm)
    for cut in (0, 3, 10, len(data) - 1):
        with pytest.raises(ValueError):
            unpack_heights(data[:cut])
