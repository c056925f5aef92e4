"""The continuation of a surface into holes: each level gives the reference's heights."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from tests.kernels.holes.test_hole_filling import CELL, lengths, rough_field
from tests.strategies import seeds


@pytest.mark.parametrize("level", levels())
@given(
    seeds, lengths, lengths, st.sampled_from([0.02, 0.2, 0.6, 0.95]), st.integers(0, 60), st.integers(0, 90)
)
def test_native_is_the_reference(level, seed, height, width, share, first, end):
    field, rows = rough_field(seed, height, width, share), slice(first, max(first, end))
    found, expected = (load(name).continue_surface(field, CELL, rows=rows) for name in (level, "reference"))
    np.testing.assert_allclose(found.height, expected.height, atol=1e-9)
    np.testing.assert_allclose(found.probability, expected.probability, atol=1e-12)


@pytest.mark.parametrize("name", ["reference", *levels()])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"field": np.ones(5)}, "field must have the shape (Ny, Nx), not (5,)"),
        ({"cell": -1.0}, "cell must be positive, not -1"),
        ({"rows": slice(0, 5, 2)}, "rows must be next to each other, not every 2"),
    ],
)
def test_arguments_that_do_not_fit_are_named(name, change, message):
    with pytest.raises(KernelError) as error:
        load(name).continue_surface(**({"field": np.ones((5, 6)), "cell": 1.0} | change))
    assert str(error.value) == message
