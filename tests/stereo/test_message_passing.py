"""Messages between doubtful pixels: who hears whom, and what becomes of states."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.kernels import load
from beltscape.stereo.multiview.confidence.message_passing import (
    ACCEPTED,
    FIRST_UNCERTAIN,
    OFFSETS,
    REJECTED,
    MessageRound,
    assign_addresses,
    load_message_rounds,
    neighbour_addresses,
    pass_messages,
)
from beltscape.stereo.multiview.networks import load_network
from tests.strategies import seeds

SAID, KEPT = 3, 2
steps = st.sampled_from([1, 2])


def masks(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Who is asked, and who is sure."""
    shape = rng.integers(3, 20, 2)
    kind = rng.integers(0, 3, shape)
    kind[tuple(rng.integers(0, shape))] = 0
    return kind == 0, kind == 1


def a_round(rng: np.random.Generator, answers: int) -> MessageRound:
    """Some network."""
    inputs = len(OFFSETS) * SAID + KEPT
    layers = rng.normal(0, 0.3, (4, inputs + 1)), rng.normal(0, 0.3, (answers, 5))
    others = rng.normal(size=(2, SAID)).astype(np.float32)
    return MessageRound(others, tuple(layer.astype(np.float32) for layer in layers))


def some_rounds(rng: np.random.Generator) -> list[MessageRound]:
    """Two that add to the state, and one that answers."""
    return [a_round(rng, SAID + KEPT), a_round(rng, SAID + KEPT), a_round(rng, 3)]


def by_pixel(
    state: np.ndarray, asked: np.ndarray, sure: np.ndarray, step: int, each: MessageRound
) -> np.ndarray:
    """What a round answers, a pixel at a time."""
    at = {tuple(place): i for i, place in enumerate(np.argwhere(asked))}
    found = []
    for (row, column), own in at.items():
        length = []
        for du, dv in OFFSETS:
            who = tuple(np.clip((row + step * dv, column + step * du), 0, np.array(asked.shape) - 1))
            length.append(state[:SAID, at[who]] if who in at else each.fixed_messages[int(sure[who])])
        x = np.concatenate([np.stack(length, -1).ravel(), state[SAID:, own]])
        hidden, answer = each.layers
        found.append(answer[:, :-1] @ np.maximum(hidden[:, :-1] @ x + hidden[:, -1], 0) + answer[:, -1])
    return np.stack(found, -1)


@given(seeds, steps)
def test_round_uses_the_messages_of_nine_pixels_and_the_own_state(seed, step):
    rng = np.random.default_rng(seed)
    asked, sure = masks(rng)
    state = rng.normal(size=(SAID + KEPT, asked.sum())).astype(np.float32)
    each = a_round(rng, 3)
    found = each.evaluate(state, neighbour_addresses(assign_addresses(asked, sure), asked, step), load(), 1)
    np.testing.assert_allclose(found, by_pixel(state, asked, sure, step, each), rtol=1e-4, atol=1e-4)


@given(seeds)
def test_addresses_number_uncertain_pixels_row_by_row(seed):
    asked, sure = masks(np.random.default_rng(seed))
    found = assign_addresses(asked, sure)
    assert found[asked].tolist() == list(range(FIRST_UNCERTAIN, FIRST_UNCERTAIN + asked.sum()))
    assert (found[~asked] == np.where(sure, ACCEPTED, REJECTED)[~asked]).all()


def test_three_rounds_reach_pixels_three_apart():
    rng = np.random.default_rng(5)
    asked = np.ones((1, 30), bool)
    around = neighbour_addresses(assign_addresses(asked, ~asked), asked, 1)
    state = rng.normal(size=(SAID + KEPT, 30)).astype(np.float32)
    moved = state.copy()
    moved[:, 12] += 1
    through = some_rounds(rng)
    before, after = (pass_messages(x.copy(), around, through, load(), 1) for x in (state, moved))
    assert np.flatnonzero((before != after).any(axis=0)).tolist() == list(range(9, 16))


def test_rounds_add_to_the_state_and_the_last_gives_the_outputs():
    rng = np.random.default_rng(6)
    asked, sure = masks(rng)
    around = neighbour_addresses(assign_addresses(asked, sure), asked, 1)
    state = rng.normal(size=(SAID + KEPT, asked.sum())).astype(np.float32)
    through = some_rounds(rng)
    expected = state
    for each in through[:2]:
        expected = expected + by_pixel(expected, asked, sure, 1, each)
    expected = by_pixel(expected, asked, sure, 1, through[2])
    np.testing.assert_allclose(
        pass_messages(state.copy(), around, through, load(), 1), expected, rtol=1e-3, atol=1e-3
    )


@pytest.mark.parametrize("threads", [2, 3])
def test_outputs_do_not_depend_on_the_number_of_threads(threads):
    rng = np.random.default_rng(7)
    asked = rng.random((120, 150)) < 0.8
    around = neighbour_addresses(assign_addresses(asked, ~asked), asked, 2)
    state = rng.normal(size=(SAID + KEPT, asked.sum())).astype(np.float32)
    through = some_rounds(rng)
    one, many = (pass_messages(state.copy(), around, through, load(), n) for n in (1, threads))
    assert one.tobytes() == many.tobytes()


def test_shipped_rounds_have_consistent_sizes():
    state, length = (
        len(load_network("refinement").layers[-1]),
        load_message_rounds()[0].fixed_messages.shape[1],
    )
    for each in load_message_rounds():
        assert each.fixed_messages.shape == (2, length)
        assert each.layers[0].shape[1] == len(OFFSETS) * length + state - length + 1
    assert [len(each.layers[-1]) for each in load_message_rounds()] == [state] * (
        len(load_message_rounds()) - 1
    ) + [3]
