"""Message passing between uncertain pixels: a graph convolution in rounds.

The refinement network gives each pixel a state. Its first numbers are a message to the eight pixels around. In every
round a small network computes a change of the state from the messages; the last round's network gives the result. So
the result of a pixel can depend on features several pixels away (Gilmer et al. 2017, arXiv:1704.01212, with the
messages in their order instead of their sum).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import product

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels

REJECTED, ACCEPTED, FIRST_UNCERTAIN = 0, 1, 2
"""Addresses: rejected and accepted pixels have no state of their own; uncertain ones count from the last on."""
OFFSETS = tuple((du, dv) for dv, du in product((-1, 0, 1), repeat=2))
"""Offsets of the pixels whose messages a pixel takes, itself included."""


@dataclass(frozen=True, slots=True, eq=False)
class MessageRound:
    """The network of one round, and the messages of pixels without a state."""

    fixed_messages: NDArray[np.float32]
    """(2, K) messages of rejected and of accepted pixels."""
    layers: tuple[NDArray[np.float32], ...]
    """Of a perceptron: (k, n + 1) each."""

    def evaluate(
        self, states: NDArray[np.float32], neighbours: NDArray[np.int32], kernels: Kernels, threads: int
    ) -> NDArray[np.float32]:
        """Return the network's (M, N) outputs for states (S, N) and the addresses ``neighbours`` (9, N)."""
        length = self.fixed_messages.shape[1]
        messages = np.hstack([self.fixed_messages.T, states[:length]])
        outputs = kernels.pass_messages(messages, neighbours, states[length:], self.layers, threads=threads)
        return outputs.astype(np.float32, copy=False)


@cache
def load_message_rounds() -> tuple[MessageRound, ...]:
    """Return the shipped rounds, which tools/train_refinement.py fits to simulated frames with known truth."""
    text = (files("beltscape") / "data" / "message_passing.json").read_text(encoding="utf-8")
    return tuple(
        MessageRound(_read_array(each["fixed_messages"]), tuple(map(_read_array, each["layers"])))
        for each in json.loads(text)["rounds"]
    )


def assign_addresses(uncertain: NDArray[np.bool_], accepted: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the (H, W) addresses: uncertain pixels are numbered row by row, others are accepted or rejected."""
    address = np.where(accepted, ACCEPTED, REJECTED).astype(np.int32)
    last = FIRST_UNCERTAIN + np.count_nonzero(uncertain)
    address[uncertain] = np.arange(FIRST_UNCERTAIN, last, dtype=np.int32)
    return address


def gather_neighbour_addresses(
    address: NDArray[np.int32], uncertain: NDArray[np.bool_], spacing: int
) -> NDArray[np.int32]:
    """Return the (9, N) addresses of the uncertain pixels' neighbours, ``spacing`` px apart, limited to the image."""
    rows, columns = np.nonzero(uncertain)
    height, width = address.shape
    return np.stack([
        address[np.clip(rows + spacing * dv, 0, height - 1), np.clip(columns + spacing * du, 0, width - 1)]
        for du, dv in OFFSETS
    ])  # fmt: skip


def pass_messages(
    states: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    rounds: Sequence[MessageRound],
    kernels: Kernels,
    threads: int,
) -> NDArray[np.float32]:
    """Return the (M, N) outputs of the last round, for states (S, N) and the addresses ``neighbours`` (9, N).

    The states are overwritten.
    """
    for each in rounds[:-1]:
        states += each.evaluate(states, neighbours, kernels, threads)
    return rounds[-1].evaluate(states, neighbours, kernels, threads)


def _read_array(rows: Sequence[Sequence[float]]) -> NDArray[np.float32]:
    return np.array(rows, np.float32)
