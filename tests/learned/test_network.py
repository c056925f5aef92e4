"""Networks: their evaluation, their files, and those that are shipped."""

from __future__ import annotations

import io
from dataclasses import replace
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.learned.network import Network, compute_probability, read_network, write_network
from beltscape.learned.registry import PURPOSES, load_network
from tests.strategies import seeds


def make_network(rng: np.random.Generator, sizes: tuple[int, ...]) -> Network:
    """Return a network with random weights; ``sizes`` are the numbers of features, hidden units and outputs."""
    layers = tuple(
        rng.normal(size=(units, inputs + 1)).astype(np.float32) for inputs, units in pairwise(sizes)
    )
    names = tuple(f"feature {i}" for i in range(sizes[0]))
    limits = np.sort(rng.normal(size=(2, sizes[0])), axis=0).astype(np.float32)
    return Network(names, tuple(f"output {i}" for i in range(sizes[-1])), limits, layers)


@given(seeds, st.lists(st.integers(1, 9), min_size=2, max_size=4).map(tuple))
def test_outputs_are_those_of_the_formula(seed: int, sizes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    network = make_network(rng, sizes)
    values = rng.normal(size=(sizes[0], 7))
    found = network.evaluate_values(dict(zip(network.features, values, strict=True)))
    expected = np.clip(values, network.limits[0][:, None], network.limits[1][:, None])
    for i, layer in enumerate(network.layers):
        expected = layer[:, :-1] @ expected + layer[:, -1:]
        if i < len(network.layers) - 1:
            expected = np.maximum(expected, 0)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_mean_and_sigma_come_from_mean_and_log_variance() -> None:
    layer = np.array([[2.0, 1.0], [0.0, np.log(9)]], np.float32)
    network = Network(("x",), ("mean", "log variance"), np.array([[-9.0], [9.0]], np.float32), (layer,))
    mean, sigma = network.predict_mean_and_sigma({"x": np.array([0.0, 1.5])})
    np.testing.assert_allclose(mean, [1, 4])
    np.testing.assert_allclose(sigma, [3, 3], rtol=1e-6)


def test_probability_of_a_logit() -> None:
    np.testing.assert_allclose(compute_probability(np.array([0.0, np.log(3), 1e9])), [0.5, 0.75, 1.0])


def test_a_network_survives_its_file_and_gives_the_same_bytes(tmp_path: Path) -> None:
    network = make_network(np.random.default_rng(1), (3, 4, 2))
    first, second = tmp_path / "a.npz", tmp_path / "b.npz"
    write_network(first, network)
    with first.open("rb") as stream:
        again = read_network(stream, "a.npz")
    write_network(second, again)
    assert first.read_bytes() == second.read_bytes()
    assert (again.features, again.outputs) == (network.features, network.outputs)
    np.testing.assert_array_equal(again.limits, network.limits)
    for one, two in zip(again.layers, network.layers, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"features": ("one", "two")}, "limits are"),
        ({"outputs": ("one",)}, "the last layer has 2 units"),
        ({"layers": (np.zeros((2, 9), np.float32),)}, "layer_0 is"),
        ({"layers": (np.full((2, 4), np.nan, np.float32),)}, "layer_0 has a number that is not finite"),
        ({"limits": np.full((2, 3), np.inf, np.float32)}, "limits has a number that is not finite"),
    ],
)
def test_a_file_whose_parts_do_not_fit_is_refused(change: dict[str, object], message: str) -> None:
    stream = io.BytesIO()
    write_network(stream, replace(make_network(np.random.default_rng(1), (3, 4, 2)), **change))  # type: ignore[arg-type]
    stream.seek(0)
    with pytest.raises(InputError, match=f"some.npz: {message}"):
        read_network(stream, "some.npz")


@pytest.mark.parametrize(
    ("arrays", "missing"),
    [
        (("features",), "outputs"),
        (("features", "outputs", "limits"), "layer_0"),
        (("features", "outputs", "limits", "layer_0", "layer_2"), "layer_1"),
    ],
)
def test_an_array_that_is_missing_is_named(arrays: tuple[str, ...], missing: str) -> None:
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **dict.fromkeys(arrays, np.zeros((2, 2))))
    stream.seek(0)
    with pytest.raises(InputError, match=f"x.npz: has no array {missing};"):
        read_network(stream, "x.npz")


@pytest.mark.parametrize("part", [0, 0.5, 0.99])
def test_a_file_that_ends_early_is_refused(part: float) -> None:
    stream = io.BytesIO()
    write_network(stream, make_network(np.random.default_rng(1), (3, 4, 2)))
    whole = stream.getvalue()
    with pytest.raises(InputError, match="is no readable file of arrays"):
        read_network(io.BytesIO(whole[: int(part * len(whole))]), "some.npz")


def test_a_weight_of_which_a_bit_flipped_is_refused() -> None:
    network = make_network(np.random.default_rng(1), (3, 4, 2))
    stream = io.BytesIO()
    write_network(stream, network)
    damaged = bytearray(stream.getvalue())
    damaged[damaged.index(network.layers[0].tobytes())] ^= 1
    with pytest.raises(InputError, match="is no readable file of arrays"):
        read_network(io.BytesIO(damaged), "some.npz")


@pytest.mark.parametrize("name", PURPOSES)
def test_every_shipped_network_is_whole(name: str) -> None:
    network = load_network(name)
    assert len(set(network.features)) == len(network.features)
    assert (network.limits[0] <= network.limits[1]).all()
    assert all(np.isfinite(layer).all() for layer in network.layers)
    assert network.parameters == sum(layer.size for layer in network.layers)
    assert import_module(PURPOSES[name].used_by)


def test_an_unknown_network_is_named() -> None:
    with pytest.raises(InputError, match="no network is called nothing; there are initial_confidence"):
        load_network("nothing")
