"""Values at offsets from pixels: the reference of `gather`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.images.gathering import GatherInput


def gather(given: GatherInput) -> tuple[NDArray[np.float32]]:
    """Return the values (P K, N)."""
    height, width = given.planes[0].shape
    du, dv = given.offsets.T[..., None]
    row = np.clip(given.v.astype(int) + dv, 0, height - 1)
    column = np.clip(given.u.astype(int) + du, 0, width - 1)
    return (np.concatenate([plane[row, column] for plane in given.planes]),)
