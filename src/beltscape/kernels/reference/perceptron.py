"""The reference of `perceptron`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_perceptron import perceptron_input


def perceptron(
    planes: Sequence[NDArray[np.floating]],
    limits: NDArray[np.floating],
    hidden: NDArray[np.floating],
    output: NDArray[np.floating],
    *,
    threads: int = 0,
) -> list[NDArray[np.float64]]:
    """See `beltscape.kernels.protocol.perceptron`; ``threads`` is ignored here."""
    del threads
    given = perceptron_input(planes, limits, hidden, output)
    x = np.stack(given.planes, axis=-1).astype(np.float64)
    low, high = given.limits.astype(np.float64)
    x = np.minimum(np.maximum(np.where(np.isnan(x), low, x), low), high)
    units = np.maximum(x @ given.hidden[:, :-1].T.astype(np.float64) + given.hidden[:, -1], 0)
    answers = units @ given.output[:, :-1].T.astype(np.float64) + given.output[:, -1]
    return list(np.moveaxis(answers, -1, 0))
