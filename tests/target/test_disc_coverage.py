"""Exact coverage of pixels by discs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.target.pattern_formats import compute_disc_coverage
from tests.thorough import examples

CENTERS = st.floats(40, 50)


def sampled(size, x, y, radius, n):
    """Coverage by counting n × n samples in each pixel."""
    width, height = size
    u, v = ((np.arange(side * n) + 0.5) / n - 0.5 for side in size)
    inside = (u - x) ** 2 + ((v - y) ** 2)[:, None] <= radius**2
    return inside.reshape(height, n, width, n).mean(axis=(1, 3))


@examples(30)
@given(st.floats(-1, 12), st.floats(-1, 10), st.floats(0.3, 4))
def test_each_pixel_gets_the_share_that_is_covered(x, y, radius):
    got = compute_disc_coverage((12, 10), np.array([[x, y, radius, 1.0]]))
    np.testing.assert_allclose(got, sampled((12, 10), x, y, radius, 60), atol=0.012)


@pytest.mark.parametrize(("x", "y", "radius"), [(4.3, 5.1, 2.64), (5, 5, 3.5), (4.9, 4.2, 0.4)])
def test_each_share_is_exact(x, y, radius):
    """Against the chords of the disc in 20,000 slices of each column."""
    n = 20_000
    u = (np.arange(10 * n) + 0.5) / n - 0.5 - x
    half = np.sqrt(np.maximum(radius**2 - u**2, 0))
    edges = np.arange(11)[:, None] - 0.5
    length = np.diff(np.clip(edges, y - half, y + half), axis=0)
    got = compute_disc_coverage((10, 10), np.array([[x, y, radius, 1.0]]))
    np.testing.assert_allclose(got, length.reshape(10, 10, n).mean(axis=2), atol=1e-6)


@examples(60)
@given(CENTERS, CENTERS, st.floats(0.3, 30), st.floats(0.1, 1))
def test_area_is_exact(x, y, radius, weight):
    image = compute_disc_coverage((92, 91), np.array([[x, y, radius, weight]]))
    assert image.sum() == pytest.approx(weight * np.pi * radius**2, abs=1e-9)
    assert image.min() > -1e-9
    assert image.max() < weight + 1e-9


@examples(60)
@given(CENTERS, CENTERS, st.floats(2, 30))
def test_centroid_is_accurate_to_the_pixel_size(x, y, radius):
    """A pixel shows how much of it is covered, not where: the centroid strays, less the larger the disc."""
    image = compute_disc_coverage((92, 91), np.array([[x, y, radius, 1.0]]))
    row, column = np.indices(image.shape)
    off = np.hypot((image * column).sum() / image.sum() - x, (image * row).sum() / image.sum() - y)
    assert off < 0.05 / radius**1.5


def test_discs_of_any_size_add_up_and_are_cut_at_the_border():
    discs = np.array([[0.2, 0.1, 2.6, 1.0], [30, 20, 9.5, 0.5], [59.4, 39.4, 3.0, 1.0], [-80, 5, 4, 1]])
    together = compute_disc_coverage((60, 40), discs)
    apart = sum(compute_disc_coverage((60, 40), disc[None]) for disc in discs)
    np.testing.assert_allclose(together, apart, atol=1e-12)
    assert together[0, 0] == pytest.approx(1)
    assert compute_disc_coverage((60, 40), discs[3:]).sum() == 0


def test_no_discs_leave_the_plane_empty():
    assert compute_disc_coverage((8, 6), np.empty((0, 4))).tolist() == np.zeros((6, 8)).tolist()
