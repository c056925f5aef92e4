"""Lists of pixels, and their division into parts of limited size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Pixels = tuple[NDArray[np.int_], ...]
"""Rows and columns of some pixels."""


def split_pixels(mask: NDArray[np.bool_], most: int) -> list[Pixels]:
    """Return the pixels of a mask (H, W) row by row, in parts of at most ``most``."""
    rows, columns = np.nonzero(mask)
    parts = (slice(first, first + most) for first in range(0, len(rows), most))
    return [(rows[part], columns[part]) for part in parts]
