"""Rocks: size distribution and shape."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from beltscape.simulate.shapes import make_box, make_cylinder
from beltscape.simulate.solids.rocks import (
    ShapeSettings,
    SizeSettings,
    compute_centroid,
    draw_sizes,
    make_rock,
)
from tests.strategies import seeds
from tests.thorough import examples

LAWS = [
    SizeSettings(),
    SizeSettings(median_mm=30, exponent=1.2, largest_mm=120),
    SizeSettings(law="gaudin-schuhmann", exponent=0.7, smallest_mm=5),
]


@pytest.mark.parametrize("law", LAWS)
def test_mass_of_drawn_sizes_follows_the_law(law):
    size = np.sort(draw_sizes(law, 20_000, np.random.default_rng(3)))
    assert law.smallest_mm <= size[0] < 1.01 * law.smallest_mm
    assert size[-1] <= law.largest_mm
    passing = np.cumsum(size**3) / (size**3).sum()
    np.testing.assert_allclose(law.share_passing(size), passing, atol=0.01)


def test_share_passing_follows_the_law_between_its_ends():
    law = SizeSettings(median_mm=40, exponent=1.0, smallest_mm=1e-6, largest_mm=1e4)
    np.testing.assert_allclose(
        law.share_passing(np.array([0, 40.0, 80, 120, 2e4])), [0, 0.5, 0.75, 0.875, 1], atol=1e-6
    )
    law = SizeSettings(law="gaudin-schuhmann", exponent=0.5, smallest_mm=1e-9, largest_mm=100)
    assert law.share_passing(np.array([25.0])) == pytest.approx(0.5, abs=1e-5)


def test_few_rocks_are_spread_over_all_sizes():
    few = np.sort(draw_sizes(SizeSettings(), 50, np.random.default_rng(1)))
    many = np.quantile(
        draw_sizes(SizeSettings(), 50_000, np.random.default_rng(2)), (np.arange(50) + 0.5) / 50
    )
    np.testing.assert_allclose(few[:45], many[:45], rtol=0.05)


def test_sizes_in_the_wrong_order_are_refused():
    with pytest.raises(ValidationError, match="must be below"):
        SizeSettings(smallest_mm=50, largest_mm=40)


@examples(40)
@given(
    seed=seeds,
    size=st.floats(3, 150),
    shape=st.builds(
        ShapeSettings,
        longest=st.floats(1, 3),
        flattest=st.floats(0.3, 1),
        roughness=st.floats(0, 0.15),
        lean_deg=st.floats(0, 90),
        corners=st.tuples(st.integers(6, 12), st.integers(12, 30)),
    ),
)
def test_rock_is_closed_about_its_centroid_and_has_its_size(seed, size, shape):
    rock = make_rock(size, shape, np.random.default_rng(seed))
    mesh = rock.mesh
    assert mesh.is_closed
    np.testing.assert_allclose(compute_centroid(mesh), 0, atol=1e-9 * size)
    extents = np.ptp(mesh.vertices_mm, axis=0)
    assert 0.03 * size**3 < mesh.volume_mm3 < np.prod(extents)
    # the middle extent along the principal axes is the size; no extent along any axis is below the smallest one
    assert extents.max() > 0.8 * size
    a, b, c = np.moveaxis(mesh.vertices_mm[mesh.faces], 1, 0)
    assert (
        (a * np.cross(b, c)).sum(axis=1) > 0
    ).all()  # every face looks away from the middle: it cuts nothing


def test_rock_without_inclination_lies_on_its_flat_side():
    shape = ShapeSettings(lean_deg=0, longest=1.8, flattest=0.5)
    extents = np.array(
        [np.ptp(make_rock(30.0, shape, np.random.default_rng(i)).mesh.vertices_mm, axis=0) for i in range(40)]
    )
    assert np.median(extents[:, 2]) < 30 < np.median(extents[:, :2])
    assert (extents[:, 2] < 1.05 * extents[:, :2].min(axis=1)).mean() > 0.8


def test_few_corners_make_few_large_faces():
    few, many = (
        make_rock(20.0, ShapeSettings(corners=corners, roughness=0), np.random.default_rng(1)).mesh
        for corners in ((8, 8), (60, 60))
    )
    assert len(np.unique(few.vertices_mm, axis=0)) < len(np.unique(many.vertices_mm, axis=0)) / 4
    with pytest.raises(ValidationError, match="must not exceed"):
        ShapeSettings(corners=(12, 8))


@pytest.mark.parametrize("mesh", [make_box([3, 4, 5]), make_cylinder(2.0, 5.0)])
def test_centroid_of_known_bodies_is_exact(mesh):
    np.testing.assert_allclose(compute_centroid(mesh), [0, 0, 2.5], atol=1e-9)


def test_same_seed_makes_the_same_rock():
    one, two = (make_rock(20.0, ShapeSettings(), np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(one.mesh.vertices_mm, two.mesh.vertices_mm)
