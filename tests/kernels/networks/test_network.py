"""Small networks: each level agrees with the reference; properties that hold for any network."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.cuda.emulated_device import is_emulation_built
from beltscape.kernels.native import levels
from tests.kernels.grids import WIDTHS
from tests.kernels.planes.test_expressions import Counting, resident
from tests.kernels.rounding import emulated, first_alike
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", (*levels(), *emulated()))
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
widths = st.sampled_from(WIDTHS)


def network(seed: int, planes: int, *units: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Limits, and layers of so many units, at random."""
    rng = np.random.default_rng(seed)
    low = rng.normal(-1, 0.5, planes)
    limits = np.stack([low, low + rng.uniform(0, 3, planes)]).astype(np.float32)
    layers = (rng.normal(size=(k, n + 1)) / np.sqrt(n) for n, k in pairwise((planes, *units)))
    return limits, [layer.astype(np.float32) for layer in layers]


def features(seed: int, planes: int, height: int, width: int) -> list[np.ndarray]:
    """Planes at random, some of their pixels NaN."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(planes, height, width)).astype(np.float32)
    x[rng.random(x.shape) < 0.05] = np.nan
    return list(x)


@every_level
@given(seeds, widths, widths, st.integers(1, 80), st.lists(st.integers(1, 19), min_size=1, max_size=4))
def test_native_agrees_with_the_reference(level, seed, height, width, planes, units):
    net, x = network(seed, planes, *units), features(seed, planes, height, width)
    expected = load("reference").evaluate_network(x, *net)
    found = load(level).evaluate_network(x, *net, threads=2)
    assert len(found) == units[-1]
    for a, b in zip(found, expected, strict=True):
        assert a.dtype == np.float32
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=2e-4)


@everything
def test_outputs_are_written_where_the_caller_wants_them(name):
    net, x = network(4, 5, 8, 3), features(4, 5, 1, 40)
    table = np.full((3, 100), -7, np.float32)
    found = load(name).evaluate_network(x, *net, out=[row[None, 30:70] for row in table])
    for row, output, alone in zip(table, found, load(name).evaluate_network(x, *net), strict=True):
        assert row[30:70].tobytes() == output.tobytes() == alone.tobytes()
        assert (row[:30] == -7).all()
        assert (row[70:] == -7).all()


@pytest.mark.parametrize(
    ("out", "reason"),
    [
        ([np.empty((1, 40), np.float32)] * 2, "out must be 3 arrays, not 2"),
        ([np.empty((1, 41), np.float32)] * 3, r"out\[0\] must be contiguous float32 \(1, 40\)"),
        ([np.empty((1, 40))] * 3, r"out\[0\] must be contiguous float32"),
        ([np.empty((1, 80), np.float32)[:, ::2]] * 3, r"out\[0\] must be contiguous float32"),
    ],
)
def test_places_that_do_not_fit_the_outputs_are_refused(out, reason):
    net, x = network(4, 5, 8, 3), features(4, 5, 1, 40)
    with pytest.raises(KernelError, match=reason):
        load().evaluate_network(x, *net, out=out)


@given(seeds, widths, st.integers(1, 4))
def test_levels_that_round_alike_and_any_threads_give_the_same_bytes(seed, width, threads):
    net, x = network(seed, 7, 9, 5, 2), features(seed, 7, 37, width)
    for level in levels():
        first = load(first_alike(level)).evaluate_network(x, *net, threads=1)
        for a, b in zip(load(level).evaluate_network(x, *net, threads=threads), first, strict=True):
            assert a.tobytes() == b.tobytes()


@everything
@given(seeds)
def test_beyond_the_limits_nothing_changes_and_pixels_are_independent(name, seed):
    (limits, layers), x = network(seed, 4, 3, 1), features(seed, 4, 9, 21)
    (one,) = load(name).evaluate_network(x, limits, layers)
    held = [np.clip(np.nan_to_num(p, nan=a), a, b) for p, a, b in zip(x, *limits, strict=True)]
    (two,) = load(name).evaluate_network(held, limits, layers)
    np.testing.assert_array_equal(one, two)
    (turned,) = load(name).evaluate_network([p[::-1, ::-1] for p in x], limits, layers)
    np.testing.assert_allclose(turned[::-1, ::-1], one, rtol=1e-5, atol=1e-5)


@pytest.mark.skipif(not is_emulation_built(), reason="the emulated GPU is not built")
@given(seeds, widths, widths)
def test_a_network_computes_features_that_are_expressions_by_the_way(seed, height, width):
    net, planes = network(seed, 6, 5, 2), features(seed, 3, height, width)

    def derive(keep, planes):
        one, other, column = planes
        shared = keep(np.minimum(one, 0) * 3)
        return [one - other, one, shared, column + 0 * one, np.full_like(one, 0.5), other]

    device = Counting(seed % 3)
    kernels, backend = resident(device)
    given_ = [kernels.keep(each) for each in (*planes[:2], planes[2][:, :1])]
    derived = derive(kernels.keep, given_)
    found = kernels.evaluate_network(derived, *net)
    expected = derive(lambda each: each, (*planes[:2], planes[2][:, :1]))
    for one, other in zip(found, load(first_alike("emulated")).evaluate_network(expected, *net), strict=True):
        assert np.asarray(one).tobytes() == other.tobytes()
    assert device.launched == ["network_of_programs"]
    np.testing.assert_array_equal(derived[2], expected[2])  # is written, because others take it, too
    assert device.launched == ["network_of_programs"]
    np.testing.assert_array_equal(derived[0], expected[0])
    assert device.launched == ["network_of_programs", "evaluate_floats"]
    assert backend.failure is None


@everything
def test_an_exclusive_or_needs_and_has_its_hidden_layer(name):
    x, y = (np.array([[0, 0, 1, 1]], np.float32), np.array([[0, 1, 0, 1]], np.float32))
    hidden = np.array([[1, 1, 0], [1, 1, -1]], np.float32)
    output = np.array([[1, -2, 0], [0, 0, 7]], np.float32)
    limits = np.array([[0, 0], [1, 1]], np.float32)
    either, constant = load(name).evaluate_network([x, y], limits, [hidden, output])
    assert either.tolist() == [[0, 1, 1, 0]]
    assert constant.tolist() == [[7] * 4]


@everything
@pytest.mark.parametrize(
    ("planes", "limits", "layers", "message"),
    [
        ([], (2, 0), [(1, 1)], "planes must be 1 to 256, not 0"),
        ([(2, 3)] * 257, (2, 257), [(1, 258)], "planes must be 1 to 256, not 257"),
        ([(2, 3), (3, 2)], (2, 2), [(1, 3)], r"planes\[1\] must have the shape \(2, 3\)"),
        ([(2, 3)], (2, 2), [(1, 2)], r"limits must have the shape \(2, 1\)"),
        ([(2, 3)], (2, 1), [], "layers must be at least one"),
        ([(2, 3)], (2, 1), [(1, 1)], r"layers\[0\] must have the shape \(k, 2\)"),
        ([(2, 3)], (2, 1), [(3, 2), (1, 3)], r"layers\[1\] must have the shape \(k, 4\)"),
        ([(2, 3)], (2, 1), [(257, 2)], r"units of layers\[0\] must be 1 to 256, not 257"),
    ],
)
def test_what_does_not_fit_is_refused(name, planes, limits, layers, message):
    with pytest.raises(KernelError, match=message):
        load(name).evaluate_network([np.zeros(p) for p in planes], np.zeros(limits), [*map(np.zeros, layers)])


@everything
def test_one_layer_alone_is_linear(name):
    x = [np.array([[-3, 0, 2]], np.float32)]
    (found,) = load(name).evaluate_network(x, np.array([[-9], [9]]), [np.array([[2, 1]])])
    assert found.tolist() == [[-5, 1, 5]]
