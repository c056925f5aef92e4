"""Some of an image's pixels, a handful at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Pixels = tuple[NDArray[np.int_], NDArray[np.int_]]
"""Rows and columns of some pixels."""


def split_pixels(where: NDArray[np.bool_], most: int) -> list[Pixels]:
    """The pixels of a mask (H, W) row by row, at most so many at a time."""
    rows, columns = np.nonzero(where)
    parts = (slice(first, first + most) for first in range(0, len(rows), most))
    return [(rows[part], columns[part]) for part in parts]
