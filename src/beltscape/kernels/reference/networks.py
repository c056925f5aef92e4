"""The references of the kernels of networks: rectified layers, and a round of messages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.networks import MessagePassingInput, NetworkInput


def evaluate_network(given: NetworkInput) -> list[NDArray[np.float64]]:
    """Return the outputs, (H, W) each."""
    x = np.stack(given.planes, axis=-1).astype(np.float64)
    low, high = given.limits.astype(np.float64)
    x = np.minimum(np.maximum(np.where(np.isnan(x), low, x), low), high)
    return list(np.moveaxis(apply_layers(given.layers, x), -1, 0))


def apply_layers(layers: Sequence[NDArray[np.float32]], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the outputs (…, M) of the last layer for x (…, n)."""
    for layer in layers[:-1]:
        x = np.maximum(_affine(layer, x), 0)
    return _affine(layers[-1], x)


def _affine(layer: NDArray[np.float32], x: NDArray[np.float64]) -> NDArray[np.float64]:
    return x @ layer[:, :-1].T.astype(np.float64) + layer[:, -1]


def pass_messages(given: MessagePassingInput) -> tuple[NDArray[np.float64]]:
    """Return the outputs (M, N)."""
    received = given.messages[:, given.senders].reshape(-1, given.senders.shape[1])
    x = np.concatenate([received, given.state]).T.astype(np.float64)
    return (apply_layers(given.layers, x).T,)
