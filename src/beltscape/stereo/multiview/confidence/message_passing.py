"""Message passing between uncertain pixels: a graph convolution in rounds.

The refinement network gives each pixel a state. Its first numbers are a message to the eight pixels around. In every
round a small network computes a change of the state from the messages; the last round's network gives the result. So
the result of a pixel can depend on features several pixels away (Gilmer et al. 2017, arXiv:1704.01212, with the
messages in their order instead of their sum).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.learned.network import Network
from beltscape.learned.registry import load_network

REJECTED, ACCEPTED, FIRST_UNCERTAIN = 0, 1, 2
"""Addresses: rejected and accepted pixels have no state of their own; uncertain ones count from the last on."""
OFFSETS = tuple((du, dv) for dv, du in product((-1, 0, 1), repeat=2))
"""Offsets of the pixels whose messages a pixel takes, itself included."""


_ROUNDS = 3
"""Number of rounds; each has a network of its own."""
_FLAGS = np.array([[1, 0], [0, 1]], np.float32)
"""(2, 2) last two numbers of the messages of rejected and of accepted pixels, whose other numbers are 0."""


def load_message_rounds() -> tuple[Network, ...]:
    """Return the shipped networks of the rounds."""
    return tuple(load_network(f"message_round_{i + 1}") for i in range(_ROUNDS))


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
    padded = np.pad(address, spacing, mode="edge")
    rows, columns = np.nonzero(uncertain)
    places = (rows + spacing) * padded.shape[1] + columns + spacing
    neighbours = np.empty((len(OFFSETS), len(places)), np.int32)
    for (du, dv), row in zip(OFFSETS, neighbours, strict=True):
        np.take(padded, places + spacing * (dv * padded.shape[1] + du), out=row, mode="clip")
    return neighbours


def pass_messages(
    states: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    rounds: Sequence[Network],
    kernels: Kernels,
    threads: int,
) -> NDArray[np.float32]:
    """Return the (M, N) outputs of the last round, for states (S, N) and the addresses ``neighbours`` (9, N).

    The states are overwritten.
    """
    messages, rest = split_states(states, rounds[0])
    own = messages[: -len(_FLAGS), FIRST_UNCERTAIN:]

    def evaluate(network: Network) -> NDArray[np.float32]:
        outputs = kernels.pass_messages(messages, neighbours, rest, network.layers, threads=threads)
        return outputs.astype(np.float32, copy=False)

    *changes, last = rounds
    for network in changes:
        change = evaluate(network)
        own += change[: len(own)]
        rest += change[len(own) :]
    return evaluate(last)


def split_states(
    states: NDArray[np.float32], network: Network
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the messages (K, 2 + N) of all addresses and the rest (C, N), a view, of states (S, N), for a network.

    The networks of all rounds take messages of the same length.
    """
    # every offset gives the message and its flags as features; a pixel's own state gives the rest
    length = (len(network.features) - len(states) - len(OFFSETS) * len(_FLAGS)) // (len(OFFSETS) - 1)
    messages = np.empty((length + len(_FLAGS), FIRST_UNCERTAIN + states.shape[1]), np.float32)
    messages[:length, :FIRST_UNCERTAIN], messages[:length, FIRST_UNCERTAIN:] = 0, states[:length]
    messages[length:, :FIRST_UNCERTAIN], messages[length:, FIRST_UNCERTAIN:] = _FLAGS, 0
    return messages, states[length:]
