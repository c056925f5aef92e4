"""The load of one frame, on the grid that moves with the belt."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Rows of belt measured by one frame; row j is at belt coordinate s = j · cell."""

    first: int
    """Number of the first row."""
    height_mm: NDArray[np.float32]
    """(n, Nx) load over the empty belt; NaN where not measured."""
    sigma_mm: NDArray[np.float32]
    """(n, Nx) σ of ``height_mm``."""
    noise_mm: NDArray[np.float32]
    """(n, Nx) the part of σ that neighbouring cells share."""

    share: NDArray[np.float64]
    """(n,) share of each row that was measured, the pinholes between neighbouring points included."""
    ray_slope: NDArray[np.float64]
    """(n,) slope of the core's rays from the vertical, positive towards larger s."""
    frame: int = 0
    """Number of the frame since the start."""

    @property
    def end(self) -> int:
        """Return the number of the row after the last one."""
        return self.first + len(self.height_mm)

    def leave_out(self, cells: NDArray[np.bool_]) -> Layer:
        """Return the layer without some cells (n, Nx)."""
        height, sigma, noise = (
            np.where(cells, np.float32(np.nan), plane)
            for plane in (self.height_mm, self.sigma_mm, self.noise_mm)
        )
        lost = (cells & np.isfinite(self.height_mm)).mean(axis=1)
        return replace(
            self, height_mm=height, sigma_mm=sigma, noise_mm=noise, share=np.maximum(self.share - lost, 0.0)
        )

    def rows(self, first: int, end: int) -> Layer:
        """Return the part of the layer that lies in a range of rows."""
        part = slice(max(first, self.first) - self.first, max(min(end, self.end) - self.first, 0))
        return Layer(
            max(first, self.first),
            self.height_mm[part],
            self.sigma_mm[part],
            self.noise_mm[part],
            self.share[part],
            self.ray_slope[part],
            frame=self.frame,
        )
