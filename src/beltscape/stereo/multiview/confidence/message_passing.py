"""Doubtful pixels hear each other: a graph convolution over them, in rounds.

Each pixel's state begins with what scrutiny makes of its own evidence. The first numbers of a state are a message
to the eight pixels around; a small network adds to the state what it makes of the messages, and the last round's
network answers. So what is told of a pixel may depend on evidence several pixels away (Gilmer et al. 2017,
arXiv:1704.01212, with sums in their order instead of one sum).
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
"""Addresses: pixels that are not asked have no state of their own; those that are count from `FIRST_UNCERTAIN` on."""
OFFSETS = tuple((du, dv) for dv, du in product((-1, 0, 1), repeat=2))
"""Whom a pixel hears, itself among them."""


@dataclass(frozen=True, slots=True, eq=False)
class MessageRound:
    """What states become of messages."""

    others: NDArray[np.float32]
    """(2, K) messages of lost pixels and of sure ones."""
    layers: tuple[NDArray[np.float32], ...]
    """Of a perceptron: (k, n + 1) each."""

    def answers(
        self, state: NDArray[np.float32], around: NDArray[np.int32], kernels: Kernels, threads: int
    ) -> NDArray[np.float32]:
        """(M, N) the network's answers, of states (S, N) that hear those at the addresses ``around`` (9, N)."""
        words = self.others.shape[1]
        said = np.hstack([self.others.T, state[:words]])
        return kernels.pass_messages(said, around, state[words:], self.layers, threads=threads).astype(
            np.float32, copy=False
        )


@cache
def load_message_rounds() -> tuple[MessageRound, ...]:
    """Those that ship: what tools/fit_scrutiny.py made of simulated frames with known truth."""
    kept = json.loads((files("beltscape") / "data" / "messages.json").read_text(encoding="utf-8"))
    return tuple(
        MessageRound(_array(each["others"]), tuple(map(_array, each["layers"]))) for each in kept["rounds"]
    )


def assign_addresses(asked: NDArray[np.bool_], sure: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(H, W) of those that are asked, row by row, and of the others: sure or lost."""
    found = np.where(sure, ACCEPTED, REJECTED).astype(np.int32)
    found[asked] = np.arange(FIRST_UNCERTAIN, FIRST_UNCERTAIN + np.count_nonzero(asked), dtype=np.int32)
    return found


def neighbour_addresses(address: NDArray[np.int32], asked: NDArray[np.bool_], step: int) -> NDArray[np.int32]:
    """(9, N) addresses of whom the asked pixels hear, ``step`` px apart; beyond an edge is the edge's pixel."""
    rows, columns = np.nonzero(asked)
    height, width = address.shape
    return np.stack([
        address[np.clip(rows + step * dv, 0, height - 1), np.clip(columns + step * du, 0, width - 1)]
        for du, dv in OFFSETS
    ])  # fmt: skip


def pass_messages(
    state: NDArray[np.float32],
    around: NDArray[np.int32],
    through: Sequence[MessageRound],
    kernels: Kernels,
    threads: int,
) -> NDArray[np.float32]:
    """(M, N) what the last round answers of states (S, N) that hear those at the addresses ``around`` (9, N).

    The states are used up.
    """
    for each in through[:-1]:
        state += each.answers(state, around, kernels, threads)
    return through[-1].answers(state, around, kernels, threads)


def _array(rows: Sequence[Sequence[float]]) -> NDArray[np.float32]:
    return np.array(rows, np.float32)
