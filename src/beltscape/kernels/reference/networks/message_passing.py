"""A round of messages: the reference of `pass_messages`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.networks.message_passing import MessagePassingInput
from beltscape.kernels.reference.networks.network import apply_layers


def pass_messages(given: MessagePassingInput) -> tuple[NDArray[np.float64]]:
    """Return the outputs (M, N)."""
    received = given.messages[:, given.senders].reshape(-1, given.senders.shape[1])
    x = np.concatenate([received, given.state]).T.astype(np.float64)
    return (apply_layers(given.layers, x).T,)
