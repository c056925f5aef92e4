"""Planes without NaN: what was not measured or seen stands for itself with one number."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def fill_nan(plane: NDArray[np.floating], otherwise: float = 0.0) -> NDArray[np.float32]:
    """A copy, ``otherwise`` where it is NaN; some ten times faster than `numpy.nan_to_num`."""
    filled = np.array(plane, np.float32, order="C")
    cv2.patchNaNs(filled, otherwise)
    return filled
