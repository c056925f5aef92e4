"""Depth maps on the core camera's undistorted grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import require_array, require_like, require_number
from beltscape.core.display import Displayed
from beltscape.core.geometry.camera import Camera


@dataclass(frozen=True, slots=True, eq=False)
class DepthMap(Displayed):
    """Depth along the core camera's optical axis on its undistorted pinhole grid; NaN = not measured."""

    depth_mm: NDArray[np.float32]
    """(H, W) float32."""
    sigma_mm: NDArray[np.float32]
    """(H, W) float32, one standard deviation of it."""
    views: NDArray[np.uint8]
    """(H, W) uint8: how many auxiliary cameras measured the pixel."""
    confidence: NDArray[np.float32]
    """(H, W) float32, 0..1: probability that the pixel is not a false surface; 0 where not measured."""
    systematic_mm: float = 0.0
    """Standard deviation common to all pixels, included in ``sigma_mm``, from cameras that contradict the rig."""

    def __post_init__(self) -> None:
        """Raise ArgumentError unless all are arrays (H, W) of one shape."""
        require_array(self.depth_mm, "depth_mm", (None, None))
        for name in ("sigma_mm", "views", "confidence"):
            require_like(getattr(self, name), name, self.depth_mm, "depth_mm")
        require_number(self.systematic_mm, "systematic_mm", 0.0)

    def __repr__(self) -> str:
        height, width = self.depth_mm.shape
        z = self.depth_mm[self.measured]
        span = f"{z.min():.1f} to {z.max():.1f} mm, " if z.size else ""
        sigma = f", median σ {np.median(self.sigma_mm[self.measured]):.3f} mm" if z.size else ""
        return f"DepthMap({width}×{height}, {span}{self.coverage:.1%} measured{sigma})"

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(H, W) bool: pixels with a depth."""
        return np.isfinite(self.depth_mm)

    @property
    def coverage(self) -> float:
        """Share of pixels with a depth."""
        return float(self.measured.mean())

    def points_mm(self, camera: Camera) -> NDArray[np.float64]:
        """Return the points (H, W, 3) in the camera's frame, NaN where not measured (the paper's Eq. 25)."""
        depth = self.depth_mm.astype(np.float64)[..., None]
        return np.concatenate([camera.rays() * depth, depth], axis=-1)
