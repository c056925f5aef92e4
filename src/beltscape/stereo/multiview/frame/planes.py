"""Planes (H, W): replacement of NaN, enlargement, and lists of pixels."""

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


def enlarge_blocks(small: NDArray[np.floating], factor: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return (H, W) every value repeated over its block; the last row and column extend to the edge of ``shape``."""
    full = np.repeat(np.repeat(small.astype(np.float32), factor, axis=0), factor, axis=1)
    missing = [(0, whole - part) for whole, part in zip(shape, full.shape, strict=True)]
    return np.ascontiguousarray(np.pad(full, missing, mode="edge"))
