"""One frame's load, on the grid that moves with the belt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Rows of belt as one frame saw them; row j is at belt coordinate s = j · cell."""

    first: int
    """Number of the first row."""
    height_mm: NDArray[np.float32]
    """(n, Nx) load over the empty belt; NaN where not measured."""
    sigma_mm: NDArray[np.float32]
    """(n, Nx) its σ."""
    noise_mm: NDArray[np.float32]
    """(n, Nx) the part of σ that neighbouring cells share."""

    share: NDArray[np.float64]
    """(n,) share of each row that was measured, the pinholes between neighbouring points included."""
    slant: NDArray[np.float64]
    """(n,) tangent of the angle at which the core's rays come down on it, positive towards larger s."""

    @property
    def end(self) -> int:
        """Number of the row after the last one."""
        return self.first + len(self.height_mm)

    def rows(self, first: int, end: int) -> Layer:
        """The same rows as far as they lie in a range."""
        part = slice(max(first, self.first) - self.first, max(min(end, self.end) - self.first, 0))
        parts = (self.height_mm, self.sigma_mm, self.noise_mm, self.share, self.slant)
        return Layer(max(first, self.first), *(values[part] for values in parts))
