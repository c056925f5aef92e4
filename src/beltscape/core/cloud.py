"""Point clouds in a named coordinate frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points with normals, colour and uncertainty."""

    points_mm: NDArray[np.float32]
    """(N, 3) float32."""
    normals: NDArray[np.float32]
    """(N, 3) float32, unit length, towards the camera; NaN where the neighbourhood determines none."""
    colors: NDArray[np.uint8]
    """(N, 3) uint8 RGB."""
    sigma_mm: NDArray[np.float32]
    """(N,) float32, one standard deviation of the depth."""
    frame: str = "core"
    """Coordinate frame of the points."""

    def __repr__(self) -> str:
        return f"PointCloud({len(self.points_mm)} points in the frame {self.frame})"
