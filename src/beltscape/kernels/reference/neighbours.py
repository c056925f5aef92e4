"""The reference of `neighbours`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_neighbours import neighbours_input


def neighbours(
    planes: Sequence[NDArray[np.floating]],
    u: NDArray[np.integer],
    v: NDArray[np.integer],
    offsets: NDArray[np.integer],
    *,
    threads: int = 0,
) -> NDArray[np.float32]:
    """See `beltscape.kernels.protocol.neighbours`; ``threads`` is ignored here."""
    del threads
    given = neighbours_input(planes, u, v, offsets)
    height, width = given.planes[0].shape
    du, dv = given.offsets.T[..., None]
    row = np.clip(given.v.astype(int) + dv, 0, height - 1)
    column = np.clip(given.u.astype(int) + du, 0, width - 1)
    return np.stack([plane[row, column] for plane in given.planes])
