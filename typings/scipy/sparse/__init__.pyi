"""Sparse matrices by compressed columns."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

class csc_array:
    def __init__(
        self,
        arg1: tuple[NDArray[np.float64], NDArray[np.integer[Any]], NDArray[np.integer[Any]]],
        *,
        shape: tuple[int, int],
    ) -> None: ...
    def __matmul__(self, other: NDArray[np.float64]) -> NDArray[np.float64]: ...
