"""The steps of the segmentation of lumps: watershed, merging, filling of gaps, features."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError
from scipy import ndimage

from beltscape.learned.registry import load_network
from beltscape.measure.lumps.features import compute_features, fill_gaps, find_beyond
from beltscape.measure.lumps.lumps import compute_distribution, compute_passing_sizes
from beltscape.measure.lumps.segment import find_basins, find_borders, merge_regions
from beltscape.measure.lumps.settings import LumpSettings

FIELDS = arrays(np.float32, (9, 12), elements=st.floats(0, 1, width=32), unique=True)
SIZES = st.lists(st.tuples(st.floats(5, 200), st.floats(0.1, 10)), min_size=2, max_size=30)
SIEVES = np.array([10.0, 20.0, 50.0, 100.0, 250.0])


@given(FIELDS)
def test_each_basin_is_one_piece_and_has_one_lowest_place(field):
    regions = find_basins(field, -1.0)
    for number in range(regions.max() + 1):
        own = regions == number
        _, pieces = ndimage.label(own, np.ones((3, 3)))
        assert pieces == 1
        lowest = np.unravel_index(np.where(own, field, np.inf).argmin(), field.shape)
        around = tuple(slice(max(i - 1, 0), i + 2) for i in lowest)
        assert field[lowest] == field[around].min()


def test_a_flat_ground_is_one_basin():
    field = np.full((20, 30), 0.01, np.float32)
    field[:, 14] = 0.9
    regions = find_basins(field, 0.03)
    assert regions.max() == 1
    assert len(np.unique(regions[:, :14])) == 1
    assert len(np.unique(regions[:, 15:])) == 1


@given(FIELDS)
def test_merging_keeps_all_apart_or_leaves_one(field):
    regions = find_basins(field, -1.0)
    number = int(regions.max()) + 1
    if number == 1:
        return
    found = find_borders(regions, field)
    assert np.array_equal(np.sort(merge_regions(number, found, 0.0)), np.arange(number))
    assert merge_regions(number, found, 2.0).max() == 0


@given(FIELDS, st.floats(0, 1), st.floats(0, 1))
def test_a_higher_limit_never_parts_what_a_lower_one_joined(field, one, two):
    regions = find_basins(field, -1.0)
    number = int(regions.max()) + 1
    if number == 1:
        return
    found = find_borders(regions, field)
    few, many = (merge_regions(number, found, limit) for limit in (max(one, two), min(one, two)))
    pairs = np.unique(np.stack([many, few]), axis=1)
    assert len(np.unique(pairs[0])) == pairs.shape[1]


@given(arrays(bool, (12, 15)))
def test_filling_keeps_what_is_known_within_its_range(known):
    if not known.any():
        return
    value = np.random.default_rng(0).uniform(5, 6, known.shape).astype(np.float32)
    whole = fill_gaps(value, known)
    assert np.array_equal(whole[known], value[known])
    assert whole.min() >= value[known].min() - 1e-4
    assert whole.max() <= value[known].max() + 1e-4


def test_shadows_that_join_up_do_not_end_the_view():
    """A net of narrow gaps reaches from the border to the middle; a wide gap at the border, and the frame, do."""
    measured = np.ones((90, 120), bool)
    measured[::15] = measured[:, ::15] = False  # gaps of one cell around blocks of 14
    measured[:, 100:] = False
    measured[40:60, 30:50] = False  # a wide gap in the middle joins the net as well
    beyond = find_beyond(measured, 10.0)
    assert beyond[:, 102:].all()
    assert not beyond[8:-8, 8:95].any()
    assert not (beyond & measured).any()
    whole = find_beyond(np.pad(np.ones((20, 30), bool), 4), 3.0)
    assert whole.sum() == 28 * 38 - 20 * 30


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_features_turn_with_the_picture(turns):
    height = np.random.default_rng(1).normal(size=(60, 60)).astype(np.float32)
    measured = np.random.default_rng(2).random((60, 60)) > 0.1
    one = compute_features(height, measured)
    two = compute_features(np.ascontiguousarray(np.rot90(height, turns)), np.rot90(measured, turns))
    assert list(one) == list(two) == list(load_network("lumps").features)
    for name, plane in one.items():
        assert np.abs(np.rot90(plane, turns) - two[name]).max() < 1e-4


def test_features_do_not_see_a_height_or_a_far_off_slope():
    height = np.random.default_rng(1).normal(size=(40, 50)).astype(np.float32)
    measured = np.ones(height.shape, bool)
    raised = compute_features(height + 100, measured)
    for name, plane in compute_features(height, measured).items():
        assert np.abs(plane - raised[name]).max() < 5e-3


@given(SIZES, st.floats(0.1, 10), st.floats(0.1, 10))
def test_a_distribution_scales_with_sizes_and_not_with_mass(pairs, stretch, heavier):
    size, mass = np.array(pairs).T
    one = compute_distribution(size, mass, SIEVES)
    two = compute_distribution(size * stretch, mass * heavier, SIEVES * stretch)
    assert two.d_mm == pytest.approx(np.array(one.d_mm) * stretch)
    assert two.d_sigma_mm == pytest.approx(np.array(one.d_sigma_mm) * stretch, abs=1e-9)


@given(SIZES)
def test_shares_and_sizes_ascend(pairs):
    size, mass = np.array(pairs).T
    found = compute_distribution(size, mass, SIEVES)
    assert (np.diff(found.passing) >= 0).all()
    assert found.passing[-1] == pytest.approx(1)
    assert list(found.d_mm) == sorted(found.d_mm)
    assert size.min() <= found.d_mm[0]
    assert found.d_mm[-1] <= size.max()


def test_a_distribution_by_hand():
    size, mass = np.array([10.0, 20.0, 30.0]), np.array([1.0, 1.0, 2.0])
    assert compute_passing_sizes(size, mass, (0.125, 0.375, 0.75)) == pytest.approx([10, 20, 30])
    found = compute_distribution(size, mass, np.array([15.0, 20.0, 40.0]))
    assert found.passing == pytest.approx([0.25, 0.5, 1.0])


@pytest.mark.parametrize("count", [0, 1])
def test_a_single_lump_has_no_distribution(count):
    """Of one lump nothing says how others are: its size is no d50, and no sample of it would differ."""
    found = compute_distribution(np.full(count, 50.0), np.ones(count), SIEVES)
    assert found.count == count
    assert np.isnan(found.d_sigma_mm).all()
    assert np.isnan(found.d_mm).all()
    assert np.isnan(found.passing).all()


@pytest.mark.parametrize("sieves", [(), (20.0, 10.0), (10.0, 10.0)])
def test_sieves_must_ascend(sieves):
    with pytest.raises(ValidationError, match="ascend"):
        LumpSettings(sieves_mm=sieves)


def test_many_lumps_leave_the_error_of_the_method():
    """The bootstrap's σ falls with their number; outlines and hidden parts are wrong alike in all of them."""
    rng = np.random.default_rng(3)
    size = rng.lognormal(3.5, 0.4, 20_000)
    found = compute_distribution(size, size**3, SIEVES)
    assert np.array(found.d_sigma_mm) / found.d_mm == pytest.approx([0.08] * 4, rel=0.03)
    few = compute_distribution(size[:50], size[:50] ** 3, SIEVES)
    assert all(np.array(few.d_sigma_mm) / few.d_mm > 0.085)
