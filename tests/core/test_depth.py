"""Depth maps: points on the undistorted grid, NaN where not measured."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from tests.strategies import seeds


def depth_map(depth: np.ndarray) -> DepthMap:
    ones = np.ones(depth.shape, np.float32)
    return DepthMap(depth.astype(np.float32), 0.1 * ones, ones.astype(np.uint8), ones)  # pyrefly: ignore[bad-argument-type]


@given(st.integers(1, 12), st.integers(1, 9), seeds)
def test_points_project_back_onto_their_pixels(width, height, seed):
    rng = np.random.default_rng(seed)
    camera = Camera("c", (width, height), rng.uniform(50, 90, 2), rng.uniform(0, 9, 2), np.zeros(5))
    depth = rng.uniform(500, 1500, (height, width)).astype(np.float32)
    points = depth_map(depth).points_mm(camera)
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    np.testing.assert_allclose(camera.project(points), np.stack([u, v], axis=-1), atol=1e-9)
    np.testing.assert_array_equal(points[..., 2], depth)


def test_points_lie_on_the_undistorted_grid():
    camera = Camera("c", (3, 1), np.full(2, 10.0), np.zeros(2), np.array([0.5, 0.1, 0.01, 0.01, 0.1]))
    points = depth_map(np.full((1, 3), 100.0)).points_mm(camera)
    np.testing.assert_allclose(points[0], [[0, 0, 100], [10, 0, 100], [20, 0, 100]])


def test_not_measured_stays_nan():
    camera = Camera("c", (2, 2), np.ones(2), np.zeros(2), np.zeros(5))
    depth = depth_map(np.array([[1.0, np.nan], [3.0, 4.0]]))
    assert np.isnan(depth.points_mm(camera)[0, 1]).all()
    assert depth.measured.tolist() == [[True, False], [True, True]]
    assert depth.coverage == 0.75
