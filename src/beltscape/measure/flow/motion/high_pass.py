"""What of a load's height can be recognised in the next frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_SMOOTH_MM = 20.0
"""Hills broader than this do not tell a place sharply."""
_LEAST_MM = 3.0
"""Lower loads are left out: what remains of the empty belt's own errors stands still and would pull to no motion."""
_LEAST_SHARE = 0.005
_TALLEST = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """Bumps and hollows of a load, on a grid that stands still (rows along y ascending, columns along x)."""

    height_mm: NDArray[np.float64]
    """(Ny, Nx) height over the empty belt; NaN where there is no load."""
    bump_mm: NDArray[np.float64]
    """(Ny, Nx) height over the surroundings' mean, tall ones clipped; 0 where there is no load."""
    load: NDArray[np.bool_]
    """(Ny, Nx) where a load was measured."""
    cell_mm: float
    """Edge of a cell."""

    @property
    def telling(self) -> bool:
        """Whether there is any load to recognise."""
        return float(self.load.mean()) >= _LEAST_SHARE


def relief(height_mm: NDArray[np.float64], cell_mm: float, noise_mm: float) -> Relief:
    """Relief of a load (Ny, Nx) over the empty belt, NaN where not measured; ``noise_mm`` is the empty belt's."""
    load = np.nan_to_num(height_mm, nan=-np.inf) > max(_LEAST_MM, 6 * noise_mm)
    # lone cells are flying points, not load
    load &= ndimage.uniform_filter(load.astype(np.float32), 5) > 0.5
    value = np.where(load, height_mm, 0.0)
    blur = _SMOOTH_MM / cell_mm
    weight = ndimage.gaussian_filter(load.astype(np.float64), blur)
    mean = ndimage.gaussian_filter(value, blur) / np.maximum(weight, 1e-9)
    bump = np.where(load, value - mean, 0.0)
    spread = float(np.sqrt(np.mean(bump[load] ** 2))) if load.any() else 0.0
    bump = np.clip(bump, -_TALLEST * spread, _TALLEST * spread)
    return Relief(np.where(load, height_mm, np.nan), bump, load, cell_mm)
