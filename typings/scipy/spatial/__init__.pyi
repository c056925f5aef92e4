"""Nearest neighbours and hulls."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

class ConvexHull:
    equations: NDArray[np.float64]
    simplices: NDArray[np.int32]
    vertices: NDArray[np.int32]
    def __init__(self, points: NDArray[np.floating[Any]]) -> None: ...

class KDTree:
    def __init__(self, data: NDArray[Any]) -> None: ...
    def query(
        self, x: NDArray[Any], k: int = ..., *, distance_upper_bound: float = ...
    ) -> tuple[NDArray[np.float64], NDArray[np.intp]]: ...
    def query_pairs(self, r: float, *, output_type: Literal["ndarray"]) -> NDArray[np.intp]: ...
