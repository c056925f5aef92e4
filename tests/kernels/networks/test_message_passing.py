"""Message passing: each level agrees with the reference; input that does not fit is refused."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from tests.kernels.rounding import emulated, first_alike
from tests.strategies import seeds

every_level = pytest.mark.parametrize("level", (*levels(), *emulated()))
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
few = st.integers(1, 5)


def example(seed: int, length: int, received: int, own: int, pixels: int, units: list[int]) -> tuple:
    """Return random messages, senders, state and layers of so many units."""
    rng = np.random.default_rng(seed)
    messages = rng.normal(size=(length, rng.integers(1, 40))).astype(np.float32)
    senders = rng.integers(0, messages.shape[1], (received, pixels)).astype(np.int32)
    state = rng.normal(size=(own, pixels)).astype(np.float32)
    layers = (
        rng.normal(size=(k, n + 1)) / np.sqrt(n) for n, k in pairwise((length * received + own, *units))
    )
    return messages, senders, state, [layer.astype(np.float32) for layer in layers]


@every_level
@given(seeds, few, few, few, st.integers(1, 70), st.lists(st.integers(1, 9), min_size=1, max_size=3))
def test_native_agrees_with_the_reference(level, seed, length, received, own, pixels, units):
    given_ = example(seed, length, received, own, pixels, units)
    expected, found = load("reference").pass_messages(*given_), load(level).pass_messages(*given_, threads=2)
    assert found.dtype == np.float32
    assert found.shape == (units[-1], pixels)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=2e-4)


@everything
def test_inputs_are_the_messages_by_component_and_then_the_state(name):
    messages, senders = np.array([[1, 2, 3], [4, 5, 6]], np.float32), np.array([[2], [0]], np.int32)
    each = np.hstack([np.eye(5), np.zeros((5, 1))]).astype(np.float32)
    found = load(name).pass_messages(messages, senders, np.array([[7.0]], np.float32), [each])
    assert found[:, 0].tolist() == [3, 1, 6, 4, 7]


@every_level
def test_pixels_depend_neither_on_others_in_the_call_nor_on_threads(level):
    messages, senders, state, layers = example(3, 4, 9, 7, 3000, [11, 3])
    whole = load(level).pass_messages(messages, senders, state, layers, threads=1)
    assert load(level).pass_messages(messages, senders, state, layers, threads=3).tobytes() == whole.tobytes()
    part = load(level).pass_messages(messages, senders[:, 100:117], state[:, 100:117], layers)
    assert part.tobytes() == whole[:, 100:117].tobytes()
    assert (
        load(first_alike(level)).pass_messages(messages, senders, state, layers).tobytes() == whole.tobytes()
    )


@everything
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"senders": np.array([[0, 3]], np.int32)}, "senders must be 0 to 2, not 0 to 3"),
        ({"senders": np.array([[-1, 0]], np.int32)}, "senders must be 0 to 2, not -1 to 0"),
        ({"senders": np.zeros((1, 2))}, r"senders must be \(H, N\) int32, not float64"),
        ({"state": np.zeros((1, 3))}, r"state must have the shape \(C, 2\)"),
        ({"layers": [np.zeros((1, 3))]}, r"layers\[0\] must have the shape \(k, 4\)"),
        ({"layers": []}, "layers must be at least one"),
        ({"messages": np.zeros((300, 3))}, "inputs must be 1 to 256, not 301"),
    ],
)
def test_what_does_not_fit_is_refused(name, change, message):
    fits = {
        "messages": np.zeros((2, 3)), "senders": np.array([[0, 2]], np.int32), "state": np.zeros((1, 2)),
        "layers": [np.zeros((1, 4))],
    }  # fmt: skip
    with pytest.raises(KernelError, match=message):
        load(name).pass_messages(**(fits | change))


@pytest.mark.parametrize("name", emulated())
@given(seeds, st.integers(1, 3))
def test_rounds_on_the_device_are_those_call_by_call(name, seed, count):
    rng = np.random.default_rng(seed)
    length, own, pixels = rng.integers(1, 6), rng.integers(1, 4), 40
    states = [rng.normal(size=pixels).astype(np.float32) for _ in range(length + own)]
    senders = rng.integers(0, pixels + 2, (3, pixels)).astype(np.int32)
    inputs = 3 * (length + 2) + own
    sizes = [length + own] * (count - 1) + [2]
    rounds = [[rng.normal(0, 0.3, (n, inputs + 1)).astype(np.float32)] for n in sizes]
    given_ = states, senders, rounds
    found = load(name).run_resident(lambda kernels: np.asarray(kernels.exchange_messages(*given_)))
    assert found.tobytes() == load(first_alike(name)).exchange_messages(*given_).tobytes()
