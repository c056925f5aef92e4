"""Planes (H, W): replacement of their NaN, and lists of their pixels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Pixels = tuple[NDArray[np.int_], ...]
"""Rows and columns of some pixels."""


def fill_nan(plane: NDArray[np.floating], value: float = 0.0) -> NDArray[np.float32]:
    """Return a copy with ``value`` in place of NaN; about ten times faster than `numpy.nan_to_num`."""
    filled = np.array(plane, np.float32, order="C")
    cv2.patchNaNs(filled, value)
    return filled


def split_pixels(mask: NDArray[np.bool_], most: int) -> list[Pixels]:
    """Return the pixels of a mask (H, W) row by row, in parts of at most ``most``."""
    rows, columns = np.nonzero(mask)
    parts = (slice(first, first + most) for first in range(0, len(rows), most))
    return [(rows[part], columns[part]) for part in parts]
