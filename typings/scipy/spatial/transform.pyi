"""Rotations."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

class Rotation:
    @classmethod
    def from_matrix(cls, matrix: NDArray[Any]) -> Rotation: ...
    @classmethod
    def from_quat(cls, quat: NDArray[Any], *, scalar_first: bool = ...) -> Rotation: ...
    def as_matrix(self) -> NDArray[np.float64]: ...
    def as_quat(self, canonical: bool = ..., *, scalar_first: bool = ...) -> NDArray[np.float64]: ...
