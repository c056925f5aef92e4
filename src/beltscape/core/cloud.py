"""Point clouds in a named coordinate frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import require_array, require_instance, require_text
from beltscape.core.geometry.pose import Pose


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
    confidence: NDArray[np.float32] | None = None
    """(N,) float32, 0..1: probability that the point is not of a false surface; None if it is not known."""

    def __post_init__(self) -> None:
        """Raise ArgumentError unless there are as many normals, colours and sigmas as points."""
        require_array(self.points_mm, "points_mm", (None, 3))
        count = len(self.points_mm)
        require_array(self.normals, "normals", (count, 3))
        require_array(self.colors, "colors", (count, 3))
        require_array(self.sigma_mm, "sigma_mm", (count,))
        if self.confidence is not None:
            require_array(self.confidence, "confidence", (count,))
        require_text(self.frame, "frame")

    def transform(self, b_from_a: Pose, frame: str) -> PointCloud:
        """Return the cloud in the frame ``frame``, to which the pose leads from its own."""
        require_instance(b_from_a, Pose, "b_from_a", "bs.Pose.of(rotation, translation_mm)")
        normals = self.normals.astype(np.float64) @ b_from_a.rotation.T
        points = b_from_a.apply(self.points_mm.astype(np.float64))
        return replace(
            self, points_mm=points.astype(np.float32), normals=normals.astype(np.float32), frame=frame
        )

    def __repr__(self) -> str:
        return f"PointCloud({len(self.points_mm)} points in the frame {self.frame})"
