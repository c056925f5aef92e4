from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from beltscape.measure.mesh import from_above, triangles


def test_a_step_cuts_the_mesh_and_what_is_not_used_is_out_of_it() -> None:
    depth = np.full((4, 6), 100.0, np.float32)
    depth[:, 3:] = 50.0
    use = np.ones(depth.shape, bool)
    assert len(triangles(depth, use, 60.0)) == 2 * 3 * 5
    assert len(triangles(depth, use, 10.0)) == 2 * 3 * 4
    use[0, 0] = False
    assert len(triangles(depth, use, 60.0)) == 2 * 3 * 5 - 1


@settings(max_examples=40, deadline=None)
@given(
    slope=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    shift=st.tuples(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9)),
    scale=st.floats(0.4, 2.5),
)
def test_a_plane_is_met_exactly_wherever_its_points_lie(slope, shift, scale) -> None:
    j, i = np.mgrid[:12, :14].astype(float)
    places = np.stack([i * scale + shift[0], j * scale + shift[1]], axis=-1).reshape(-1, 2)
    height = places @ slope
    corners = triangles(np.zeros((12, 14), np.float32), np.ones((12, 14), bool), 1.0)
    top, other = from_above(places, np.column_stack([height, 2 * height]), corners, (9, 10))
    y, x = np.mgrid[:9, :10].astype(float)
    met = np.isfinite(top)
    low, high = places.min(axis=0), places.max(axis=0)
    margin = np.minimum(np.minimum(x - low[0], high[0] - x), np.minimum(y - low[1], high[1] - y))
    assert met[margin > 1e-6].all()
    assert not met[margin < -1e-6].any()
    np.testing.assert_allclose(top[met], (x * slope[0] + y * slope[1])[met], atol=1e-7)
    np.testing.assert_allclose(other[met], 2 * top[met], atol=1e-7)


def test_of_two_layers_the_upper_one_counts() -> None:
    places = np.array([[0, 0], [4, 0], [0, 4], [0, 0], [4, 0], [0, 4]], float)
    height = np.array([1, 1, 1, 5, 5, 5.0])
    corners = np.array([[3, 4, 5], [0, 1, 2]], np.int32)
    top, other = from_above(places, np.column_stack([height, -height]), corners, (5, 5))
    assert set(top[np.isfinite(top)]) == {5.0}
    assert set(other[np.isfinite(other)]) == {-5.0}
