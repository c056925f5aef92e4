"""The reference of `hear`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_hear import hear_input
from beltscape.kernels.reference.perceptron import answered


def hear(
    said: NDArray[np.floating],
    near: NDArray[np.int32],
    kept: NDArray[np.floating],
    layers: Sequence[NDArray[np.floating]],
    *,
    threads: int = 0,
) -> NDArray[np.float64]:
    """See `beltscape.kernels.protocol.hear`; ``threads`` is ignored here."""
    del threads
    given = hear_input(said, near, kept, layers)
    heard = given.said[:, given.near].reshape(-1, near.shape[1])
    x = np.concatenate([heard, given.kept]).T.astype(np.float64)
    return answered(given.layers, x).T
