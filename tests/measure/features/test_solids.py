"""Solids of a module: rays, distances and heights are consistent."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from beltscape.measure.features.solids import build_solids
from tests.synthetic.modules import module
from tests.thorough import examples


@examples(30)
@given(seed=st.integers(0, 10_000))
def test_where_a_ray_enters_the_distance_is_nothing(seed):
    rng = np.random.default_rng(seed)
    eye = np.array([rng.uniform(-200, 200), rng.uniform(-200, 200), 600.0])
    aim = np.column_stack(
        [rng.uniform(-140, 140, 400), rng.uniform(-100, 100, 400), rng.uniform(-10, 100, 400)]
    )
    for solid in build_solids(module()):
        t, top = solid.intersect(eye, aim - eye)
        hit = np.isfinite(t)
        points = eye + t[hit, None] * (aim - eye)[hit]
        assert np.abs(solid.distance(points)).max(initial=0) < 1e-9
        above = points[top[hit]]
        middle = solid.corners().mean(axis=0)
        above = above[above[:, 2] > middle[2]]  # a ray may meet a sphere from below its middle
        np.testing.assert_allclose(solid.height(above[:, 0], above[:, 1]), above[:, 2], atol=1e-6)
        low, high = solid.corners().min(axis=0) - 1e-9, solid.corners().max(axis=0) + 1e-9
        assert ((points >= low) & (points <= high)).all()


@examples(30)
@given(seed=st.integers(0, 10_000))
def test_distance_is_below_that_to_any_point_inside(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-250, 250, (200, 3))
    for solid in build_solids(module()):
        corners = solid.corners()
        samples = rng.uniform(corners.min(axis=0), corners.max(axis=0), (200, 3))
        inside = samples[solid.distance(samples) <= 0]
        far = np.linalg.norm(points[:, None] - inside[None], axis=2).min(axis=1)
        outside = solid.distance(points) > 0
        assert (solid.distance(points)[outside] <= far[outside] + 1e-9).all()
