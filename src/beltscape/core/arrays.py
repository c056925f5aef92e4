"""Types of arrays that all packages share; shapes and units stand in the docstrings of what takes or gives them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Real numbers in double precision."""
Floats = NDArray[np.floating]
"""Real numbers in either precision."""
Float32Array = NDArray[np.float32]
"""Real numbers in single precision."""
Mask = NDArray[np.bool_]
"""Truth values, such as which pixels are measured."""
Indices = NDArray[np.int64]
"""Whole numbers, mostly places in another array."""
