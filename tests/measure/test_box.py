"""The measured box of a belt: integrals over partial cells, profiles and range."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError, MeasureError
from beltscape.measure.surface import Grid, average_blocks
from beltscape.measure.volume.load import Box, compute_profiles, select_box

GRID = Grid.over((-10.0, 12.0), (-8.0, 9.0), 0.7)
EDGES = st.floats(-9.9, 11.9)
SIDES = st.floats(-7.9, 8.9)


@given(st.tuples(EDGES, EDGES), st.tuples(SIDES, SIDES))
def test_a_linear_surface_is_summed_exactly_over_any_box(across: tuple, along: tuple) -> None:
    (a, b), (c, d) = sorted(across), sorted(along)
    weights = Box((a, b), (c, d)).integration_weights(GRID)
    height = 2 + 0.3 * GRID.x_mm[None] - 0.7 * GRID.y_mm[:, None]
    exact = (b - a) * (d - c) * (2 + 0.3 * (a + b) / 2 - 0.7 * (c + d) / 2)
    assert weights.along @ height @ weights.across == pytest.approx(exact, abs=1e-9)


def test_profiles_tile_the_box() -> None:
    rng = np.random.default_rng(0)
    height, box = rng.standard_normal(GRID.shape), Box((-5.0, 6.1), (-4.0, 4.9))
    found = compute_profiles(height, np.ones(GRID.shape, bool), GRID, box, 2.0)
    weights = box.integration_weights(GRID)
    assert [p.y_mm for p in found] == pytest.approx(-4 + 8.9 / 5 * (np.arange(5) + 0.5))
    assert sum(p.area_mm2 for p in found) * 8.9 / 5 == pytest.approx(weights.along @ height @ weights.across)
    assert all(p.coverage == pytest.approx(1) for p in found)


def test_without_sides_the_box_is_what_was_measured() -> None:
    measured = (np.abs(GRID.x_mm) < 7)[None] & ((GRID.y_mm > -6) & (GRID.y_mm < 3))[:, None]
    box = select_box(measured, GRID, None, None)
    np.testing.assert_allclose(box.across_mm, [-7, 7], atol=0.8)
    np.testing.assert_allclose(box.along_mm, [-6, 3], atol=0.8)
    with pytest.raises(MeasureError, match=r"both surfaces were measured in x -6 to 7 mm and y -6 to 2 mm"):
        select_box(measured, GRID, (8.0, 11.0), None)


def test_a_box_beside_what_was_seen_is_refused_with_the_range() -> None:
    seen = Box((-10.0, 12.0), (-8.0, 9.0))
    with pytest.raises(
        MeasureError, match=r"--across 20 30: nothing was measured there; .* from -10 to 12 mm"
    ):
        seen.enclose((20.0, 30.0), None)
    with pytest.raises(InputError, match="--along 5 -5: give the lower end first"):
        seen.enclose(None, (5.0, -5.0))
    with pytest.raises(InputError, match="far larger than what was seen"):
        seen.enclose((-10.0, 1e6), None)
    assert seen.enclose((0.0, 15.0), None).across_mm == (-10.0, 15.0)


def test_blocks_mean_leaves_the_rest_out() -> None:
    np.testing.assert_allclose(average_blocks(np.arange(21.0).reshape(3, 7), 3), [[8.0, 11.0]])
