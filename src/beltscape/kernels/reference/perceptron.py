"""The reference of `perceptron`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_perceptron import perceptron_input


def perceptron(
    planes: Sequence[NDArray[np.floating]],
    limits: NDArray[np.floating],
    layers: Sequence[NDArray[np.floating]],
    *,
    threads: int = 0,
) -> list[NDArray[np.float64]]:
    """See `beltscape.kernels.protocol.perceptron`; ``threads`` is ignored here."""
    del threads
    given = perceptron_input(planes, limits, layers)
    x = np.stack(given.planes, axis=-1).astype(np.float64)
    low, high = given.limits.astype(np.float64)
    x = np.minimum(np.maximum(np.where(np.isnan(x), low, x), low), high)
    return list(np.moveaxis(answered(given.layers, x), -1, 0))


def answered(layers: Sequence[NDArray[np.float32]], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, M) what the last of the layers answers to x (…, n)."""
    for layer in layers[:-1]:
        x = np.maximum(_weighed(layer, x), 0)
    return _weighed(layers[-1], x)


def _weighed(layer: NDArray[np.float32], x: NDArray[np.float64]) -> NDArray[np.float64]:
    return x @ layer[:, :-1].T.astype(np.float64) + layer[:, -1]
