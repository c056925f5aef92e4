"""Message passing between uncertain pixels: addresses of neighbours, rounds and states."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.kernels import load
from beltscape.learned.network import Network
from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.estimate import (
    ACCEPTED,
    FIRST_UNCERTAIN,
    OFFSETS,
    REJECTED,
    assign_addresses,
    gather_neighbour_addresses,
    load_message_rounds,
    pass_messages,
)
from tests.strategies import seeds

MESSAGE, STATE = 3, 2
steps = st.sampled_from([1, 2])


def draw_masks(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the masks of uncertain and of accepted pixels."""
    shape = rng.integers(3, 20, 2)
    kind = rng.integers(0, 3, shape)
    kind[tuple(rng.integers(0, shape))] = 0
    return kind == 0, kind == 1


def make_round(rng: np.random.Generator, outputs: int) -> Network:
    """Return a round with random weights."""
    inputs = len(OFFSETS) * (MESSAGE + 2) + STATE
    layers = rng.normal(0, 0.3, (4, inputs + 1)), rng.normal(0, 0.3, (outputs, 5))
    names = tuple(map(str, range(inputs)))
    limits = np.array([[-9.0], [9.0]], np.float32).repeat(inputs, 1)
    return Network(names, names[:outputs], limits, tuple(layer.astype(np.float32) for layer in layers))


def make_rounds(rng: np.random.Generator) -> list[Network]:
    """Return two rounds that add to the state, and one that gives outputs."""
    return [make_round(rng, MESSAGE + STATE), make_round(rng, MESSAGE + STATE), make_round(rng, 3)]


def evaluate_by_pixel(
    state: np.ndarray, uncertain: np.ndarray, accepted: np.ndarray, step: int, each: Network
) -> np.ndarray:
    """Return the outputs of a round, computed pixel by pixel."""
    at = {tuple(pixel): i for i, pixel in enumerate(np.argwhere(uncertain))}
    found = []
    for (row, column), own in at.items():
        messages = []
        for du, dv in OFFSETS:
            neighbour = tuple(
                np.clip((row + step * dv, column + step * du), 0, np.array(uncertain.shape) - 1)
            )
            inside = neighbour in at
            message = state[:MESSAGE, at[neighbour]] if inside else np.zeros(MESSAGE)
            messages.append(
                [*message, not inside and not accepted[neighbour], not inside and accepted[neighbour]]
            )
        x = np.concatenate([np.stack(messages, -1).ravel(), state[MESSAGE:, own]])
        hidden, output = each.layers
        found.append(output[:, :-1] @ np.maximum(hidden[:, :-1] @ x + hidden[:, -1], 0) + output[:, -1])
    return np.stack(found, -1)


@given(seeds, steps)
def test_round_uses_the_messages_of_nine_pixels_and_the_own_state(seed, step):
    rng = np.random.default_rng(seed)
    uncertain, accepted = draw_masks(rng)
    state = rng.normal(size=(MESSAGE + STATE, uncertain.sum())).astype(np.float32)
    each = make_round(rng, 3)
    around = gather_neighbour_addresses(assign_addresses(uncertain, accepted), uncertain, step)
    found = pass_messages(state, around, [each], load(), 1)
    np.testing.assert_allclose(
        found, evaluate_by_pixel(state, uncertain, accepted, step, each), rtol=1e-4, atol=1e-4
    )


@given(seeds)
def test_addresses_number_uncertain_pixels_row_by_row(seed):
    uncertain, accepted = draw_masks(np.random.default_rng(seed))
    found = assign_addresses(uncertain, accepted)
    assert found[uncertain].tolist() == list(range(FIRST_UNCERTAIN, FIRST_UNCERTAIN + uncertain.sum()))
    assert (found[~uncertain] == np.where(accepted, ACCEPTED, REJECTED)[~uncertain]).all()


def test_three_rounds_reach_pixels_three_apart():
    rng = np.random.default_rng(5)
    uncertain = np.ones((1, 30), bool)
    around = gather_neighbour_addresses(assign_addresses(uncertain, ~uncertain), uncertain, 1)
    state = rng.normal(size=(MESSAGE + STATE, 30)).astype(np.float32)
    moved = state.copy()
    moved[:, 12] += 1
    rounds = make_rounds(rng)
    before, after = (pass_messages(x.copy(), around, rounds, load(), 1) for x in (state, moved))
    assert np.flatnonzero((before != after).any(axis=0)).tolist() == list(range(9, 16))


def test_rounds_add_to_the_state_and_the_last_gives_the_outputs():
    rng = np.random.default_rng(6)
    uncertain, accepted = draw_masks(rng)
    around = gather_neighbour_addresses(assign_addresses(uncertain, accepted), uncertain, 1)
    state = rng.normal(size=(MESSAGE + STATE, uncertain.sum())).astype(np.float32)
    rounds = make_rounds(rng)
    expected = state
    for each in rounds[:2]:
        expected = expected + evaluate_by_pixel(expected, uncertain, accepted, 1, each)
    expected = evaluate_by_pixel(expected, uncertain, accepted, 1, rounds[2])
    np.testing.assert_allclose(
        pass_messages(state.copy(), around, rounds, load(), 1), expected, rtol=1e-3, atol=1e-3
    )


@pytest.mark.parametrize("threads", [2, 3])
def test_outputs_do_not_depend_on_the_number_of_threads(threads):
    rng = np.random.default_rng(7)
    uncertain = rng.random((120, 150)) < 0.8
    around = gather_neighbour_addresses(assign_addresses(uncertain, ~uncertain), uncertain, 2)
    state = rng.normal(size=(MESSAGE + STATE, uncertain.sum())).astype(np.float32)
    rounds = make_rounds(rng)
    one, many = (pass_messages(state.copy(), around, rounds, load(), n) for n in (1, threads))
    assert one.tobytes() == many.tobytes()


def test_shipped_rounds_have_consistent_sizes():
    state, rounds = load_network("refinement").outputs, load_message_rounds()
    message = sum(name.startswith("message") for name in state)
    for each in rounds:
        own = [name for name in each.features if name.startswith("state")]
        assert len(own) == len(state) - message
        assert len(each.features) == len(OFFSETS) * (message + 2) + len(own)
    assert [each.outputs for each in rounds[:-1]] == [state] * (len(rounds) - 1)
    assert rounds[-1].outputs == ("logit", "log sigma", "shift")
