"""Semi-global aggregation: each level equals the reference; properties of any costs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from tests.kernels.rounding import emulated
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", levels())
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])

JUMPS = [(0, 0), (8, 80), (8, 127), (67, 68), (8, 128), (100, 100), (300, 900), (0, 8000), (8000, 8000)]
"""Bytes, the last of them, and words up to the last of those."""
PLANES = (4, 5, 15, 16, 17, 31, 33, 63, 64, 65, 96, 97, 130)
jumps = st.sampled_from(JUMPS)


def costs(seed: int, rows: int, width: int, planes: int) -> np.ndarray:
    """(rows, width, planes) uint8; often equal, and sometimes above 120."""
    rng = np.random.default_rng(seed)
    steps = rng.choice([1, 17, 61])
    return (rng.integers(0, 130 // steps, (rows, width, planes)) * steps).astype(np.uint8)


@given(seeds, st.integers(1, 7), st.integers(1, 8), st.sampled_from(PLANES), jumps)
def test_native_is_the_reference(seed, rows, width, planes, jumps):
    cost = costs(seed, rows, width, planes)
    index, margin = load("reference").aggregate(cost, *jumps)
    every = [load(level).aggregate(cost, *jumps) for level in (*levels(), *emulated())]
    for found in every:
        assert found[0].tobytes() == every[0][0].tobytes()
        assert found[1].tobytes() == every[0][1].tobytes()
    np.testing.assert_allclose(every[0][0], index, rtol=1e-6)
    np.testing.assert_allclose(every[0][1], margin, rtol=1e-6)


@everything
@given(seeds, st.sampled_from(PLANES))
def test_without_a_cost_of_jumps_the_least_cost_is_selected(name, seed, planes):
    cost = np.minimum(costs(seed, 4, 5, planes), 120)
    index, margin = load(name).aggregate(cost, 0, 0)
    least = cost.argmin(axis=2)
    assert (abs(index - least) <= 0.5).all()
    other = np.where(abs(np.arange(planes) - least[..., None]) > 1, cost, 255).min(axis=2)
    np.testing.assert_allclose(margin, (other - cost.min(axis=2).astype(float)) / 120, atol=1e-6)


@everything
@given(seeds, st.sampled_from([(8, 80), (30, 700)]), st.booleans(), st.booleans(), st.booleans())
def test_mirrored_costs_give_the_mirrored_result(name, seed, jumps, rows, columns, planes):
    cost = costs(seed, 6, 7, 20)
    cost[..., 3] = 0  # one winner: of equals the first would win
    cost[..., 12:] |= 64
    turn = tuple(slice(None, None, -1 if flip else 1) for flip in (rows, columns, planes))
    index, margin = load(name).aggregate(cost, *jumps)
    turned, turned_margin = load(name).aggregate(cost[turn], *jumps)
    np.testing.assert_allclose(turned_margin[turn[:2]], margin, rtol=1e-6)
    clear = margin > 0
    expected = 19 - index if planes else index
    np.testing.assert_allclose(turned[turn[:2]][clear], expected[clear], atol=1e-5)


@everything
def test_a_few_wrong_pixels_are_corrected_and_a_step_stays(name):
    rng = np.random.default_rng(2)
    truth = np.where(np.arange(24) < 12, 5, 14) + np.zeros((18, 1), int)
    cost = np.minimum(40 * abs(np.arange(20) - truth[..., None]), 120)
    wrong = rng.random(truth.shape) < 0.1
    cost[wrong] = np.where(np.arange(20) == 10, 80, 120)
    index, margin = load(name).aggregate(cost.astype(np.uint8), 12, 90)
    inner = np.s_[1:-1, 1:-1]  # only three paths reach a corner
    np.testing.assert_allclose(index[inner], truth[inner], atol=0.5)
    assert margin[~wrong].min() > margin[wrong].mean() > 0


@everything
@given(st.floats(3.5, 15.5))
def test_a_symmetric_v_is_found_to_a_part_of_a_plane(name, at):
    """The cost's own rounding to bytes leaves 1/60 of a plane."""
    cost = np.round(np.minimum(30 * abs(np.arange(20) - at), 120)).astype(np.uint8)
    index, _ = load(name).aggregate(np.broadcast_to(cost, (3, 4, 20)), 0, 0)
    np.testing.assert_allclose(index, at, atol=1.01 / 60)


@everything
@pytest.mark.parametrize(
    ("cost", "jumps", "message"),
    [
        (
            np.zeros((3, 4, 3), np.uint8),
            (1, 2),
            "cost must be uint8 (rows, W, D) with D from 4 to 4096, not uint8 (3, 4, 3)",
        ),
        (
            np.zeros((3, 0, 5), np.uint8),
            (1, 2),
            "cost must be uint8 (rows, W, D) with D from 4 to 4096, not uint8 (3, 0, 5)",
        ),
        (
            np.zeros((3, 4)),
            (1, 2),
            "cost must be uint8 (rows, W, D) with D from 4 to 4096, not float64 (3, 4)",
        ),
        (
            np.zeros((1, 1, 4), np.uint8),
            (3, 2),
            "jumps must be 0 <= small_jump <= large_jump <= 8000, not 3 and 2",
        ),
        (
            np.zeros((1, 1, 4), np.uint8),
            (3, 8001),
            "jumps must be 0 <= small_jump <= large_jump <= 8000, not 3 and 8001",
        ),
    ],
)
def test_wrong_input_is_named(name, cost, jumps, message):
    with pytest.raises(KernelError) as error:
        load(name).aggregate(cost, *jumps)
    assert str(error.value) == message
