"""Dart throwing: minimum distance and uniformity."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import KDTree
from scipy.stats import chi2

from beltscape.target.pattern import (
    GRAINS,
    MAX_SHARE,
    _resolve_conflicts,
    find_largest_d_min,
    saturated_count,
    throw_darts,
)
from tests.thorough import THOROUGH, examples, list_cases

NO_DISCS = np.empty((0, 3))


def throw(size, count, d_min, seed=0, keep_out=NO_DISCS):
    return throw_darts(size, count, d_min, keep_out, np.random.default_rng(seed))


def in_grains(points):
    """Exact integer positions, or the test fails."""
    grains = np.rint((points + 0.5) * GRAINS)
    np.testing.assert_array_equal((grains - GRAINS / 2) / GRAINS, points)
    return grains.astype(np.int64)


@examples(25)
@given(
    st.tuples(st.integers(20, 200), st.integers(20, 200)),
    st.integers(500, 40_000),
    st.integers(0, 2**32),
    st.floats(0.1, 0.97),
)
def test_every_point_is_farther_than_d_min_from_every_other_exactly(size, d_min_grains, seed, share):
    d_min = d_min_grains / GRAINS
    points = throw(size, max(int(share * saturated_count(size, d_min, 0, 0)), 1), d_min, seed)
    grains = in_grains(points)
    pairs = KDTree(grains).query_pairs(d_min_grains + 2, output_type="ndarray")
    squared = ((grains[pairs[:, 0]] - grains[pairs[:, 1]]) ** 2).sum(axis=1)
    assert (squared > d_min_grains**2).all()
    assert (grains >= 0).all() and (grains <= np.array(size) * GRAINS).all()


@examples(60)
@given(st.integers(0, 60), st.integers(1, 40), st.integers(0, 2**32))
def test_round_of_darts_is_accepted_as_if_thrown_one_by_one(count, d_min, seed):
    darts = np.random.default_rng(seed).integers(0, 100, (count, 2))
    kept: list[int] = []
    for i, dart in enumerate(darts):
        if all(((dart - darts[j]) ** 2).sum() > d_min**2 for j in kept):
            kept.append(i)
    np.testing.assert_array_equal(np.flatnonzero(_resolve_conflicts(darts, d_min**2)), kept)


def plain_darts(size, count, d_min, rng):
    """The definition: one dart after another, thrown at the whole plane."""
    points = np.empty((0, 2))
    while len(points) < count:
        dart = rng.random(2) * size - 0.5
        if (((points - dart) ** 2).sum(axis=1) > d_min**2).all():
            points = np.concatenate([points, [dart]])
    return points


def test_omitting_covered_cells_does_not_change_the_acceptance_on_average():
    """The mean pair counts of many small patterns against the plain definition, near saturation."""
    size, count, d_min, trials = (40, 30), 10, 8.0, 150 if THOROUGH else 60
    edges = np.array([8.0, 9, 10, 12, 15, 50])

    def mean_pairs(make):
        counts = np.empty((trials, len(edges) - 1))
        for seed in range(trials):
            points = make(seed)
            distance = np.linalg.norm(points[:, None] - points, axis=2)[np.triu_indices(count, 1)]
            counts[seed] = np.histogram(distance, edges)[0]
        return counts.mean(axis=0), counts.std(axis=0) / np.sqrt(trials)

    ours, s1 = mean_pairs(lambda seed: throw(size, count, d_min, seed))
    plain, s2 = mean_pairs(lambda seed: plain_darts(size, count, d_min, np.random.default_rng(seed)))
    assert (np.abs(ours - plain) < 4 * np.hypot(s1, s2)).all()


def test_points_are_uniform_over_the_plane_over_many_seeds():
    """Sparse points hardly know each other, so chi² over 8×6 blocks holds for those of many throws together."""
    size = (160, 120)
    points = np.concatenate([throw(size, 200, 2.0, seed) for seed in range(12)])
    counts = np.histogram2d(points[:, 0], points[:, 1], (8, 6), ((-0.5, 159.5), (-0.5, 119.5)))[0]
    statistic = ((counts - 50) ** 2 / 50).sum()
    assert chi2.cdf(statistic, 47) < 0.999


@pytest.mark.parametrize("seed", list_cases(range(3), [0]))
def test_counts_per_block_vary_less_than_for_independent_points(seed):
    points = throw((480, 320), 1500, 7.0, seed)
    counts = np.histogram2d(points[:, 0], points[:, 1], (6, 4), ((-0.5, 479.5), (-0.5, 319.5)))[0]
    statistic = ((counts - counts.mean()) ** 2 / counts.mean()).sum()
    assert statistic < chi2.ppf(0.001, 23)


def test_keep_out_discs_stay_empty_and_only_they():
    disc = np.array([[49.5, 39.5, 20.0]])
    points = np.concatenate([throw((100, 80), 60, 6.0, seed, disc) for seed in range(30 if THOROUGH else 12)])
    distance = np.linalg.norm(points - disc[0, :2], axis=1)
    assert 20 < distance.min() < 20.2


def test_points_depend_on_the_seed_only():
    assert throw((200, 100), 200, 6.0, 5).tobytes() == throw((200, 100), 200, 6.0, 5).tobytes()
    assert throw((200, 100), 200, 6.0, 5).tobytes() != throw((200, 100), 200, 6.0, 6).tobytes()


def test_full_plane_gives_about_the_known_saturated_number():
    points = throw((240, 160), 10_000, 8.0)
    assert len(points) == pytest.approx(saturated_count((240, 160), 8.0, 0, 0), rel=0.03)


@pytest.mark.parametrize("d_min", [3.0, 7.0, 20.0])
@pytest.mark.parametrize("seed", list_cases(range(3), [0]))
def test_maximum_count_is_reached(d_min, seed):
    size, discs = (320, 240), np.array([[80.0, 120.0, 40.0], [240.0, 120.0, 40.0]])
    count = int(MAX_SHARE * saturated_count(size, d_min, 40.0, 2))
    assert len(throw(size, count, d_min, seed, discs)) == count


@given(st.floats(1, 1e6))
def test_largest_d_min_fits_and_the_next_does_not(count):
    def saturated(d):
        return saturated_count((640, 480), d, 3 * d, 16)

    largest = find_largest_d_min(saturated, count)
    assert largest == 0 or saturated(largest) >= count
    assert saturated(round(largest + 0.01, 2)) < count


def test_plane_full_of_discs_has_no_capacity():
    assert saturated_count((100, 100), 5.0, 60.0, 16) == 0
