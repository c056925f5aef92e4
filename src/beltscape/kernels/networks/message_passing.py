"""Message passing between pixels: one round of a graph network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import float32
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.networks.network import network_layers


class MessagePassingInput(NamedTuple):
    """Checked input of `pass_messages`."""

    messages: NDArray[np.float32]
    """(K, A)"""
    senders: NDArray[np.int32]
    """(H, N)"""
    state: NDArray[np.float32]
    """(C, N)"""
    layers: list[NDArray[np.float32]]


class MessagePassingKernels(KernelFamily):
    """Kernel of a round of messages between pixels."""

    def pass_messages(
        self,
        messages: NDArray[np.floating],
        senders: NDArray[np.int32],
        state: NDArray[np.floating],
        layers: Sequence[NDArray[np.floating]],
        *,
        threads: int = 0,
    ) -> NDArray[np.floating]:
        """Return a network's outputs for the messages that each pixel receives and its own state.

            x₀ = (messages[0, senders[0]], messages[0, senders[1]], …, messages[K − 1, senders[H − 1]], state),
            xᵢ₊₁ = max(0, Wᵢ xᵢ + wᵢ),  out = the last layer's W x + w

        Parameters
        ----------
        messages
            (K, A): a message of K numbers from each of A senders.
        senders
            (H, N): the H senders of each of N pixels.
        state
            (C, N): the rest of each pixel's own state.
        layers
            (k, n + 1), each of at most 256 units k: W and in its last column w; the first n is H K + C, at most 256.

        Returns
        -------
        (M, N) float32, a row per unit of the last layer.

        References
        ----------
        Gilmer, Schoenholz, Riley, Vinyals & Dahl, ICML 2017, arXiv:1704.01212; here messages are not summed.
        """
        messages = float32("messages", messages, ("K", "A"))
        if senders.ndim != 2 or senders.dtype != np.int32 or not senders.size:
            raise KernelError(f"senders must be (H, N) int32, not {senders.dtype} {senders.shape}")
        if senders.view(np.uint32).max() >= messages.shape[1]:  # negative numbers are large ones
            raise KernelError(
                f"senders must be 0 to {messages.shape[1] - 1}, not {senders.min()} to {senders.max()}"
            )
        state = float32("state", state, ("C", senders.shape[1]))
        weights = network_layers(layers, "inputs", len(senders) * len(messages) + len(state))
        given = MessagePassingInput(messages, np.ascontiguousarray(senders), state, weights)
        out = np.empty((len(weights[-1]), senders.shape[1]), np.float32)
        (outputs,) = self._run("pass_messages", given, (out,), threads)
        return outputs
