"""High-pass heights of a load, by which consecutive frames are registered."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_SMOOTH_MM = 20.0
"""Gaussian σ of the low-pass that is subtracted: broader hills do not determine a position sharply."""
_LEAST_MM = 3.0
"""Lower loads are excluded: errors of the empty belt stand still and would bias the registration to no motion."""
_LEAST_SHARE = 0.005
"""With a smaller share of loaded cells there is nothing to register."""
_TALLEST = 4.0
"""Heights are clipped to this multiple of their spread, so that single rocks do not dominate."""


@dataclass(frozen=True, slots=True, eq=False)
class HighPassHeights:
    """Heights and high-pass heights of a load, on a static grid (rows along y ascending, columns along x)."""

    height_mm: NDArray[np.float64]
    """(Ny, Nx) height over the empty belt; NaN where there is no load."""
    high_pass_mm: NDArray[np.float64]
    """(Ny, Nx) height over the neighbourhood's mean, clipped; 0 where there is no load."""
    load: NDArray[np.bool_]
    """(Ny, Nx) whether a load was measured."""
    cell_mm: float
    """Edge of a cell."""
    surface_mm: NDArray[np.float32]
    """(Ny, Nx) height over the empty belt wherever it was measured; NaN elsewhere."""

    def leave_out(self, cells: NDArray[np.bool_], noise_mm: float) -> HighPassHeights:
        """Return the high-pass without the load of some cells (Ny, Nx)."""
        without = compute_high_pass(np.where(cells, np.nan, self.surface_mm), self.cell_mm, noise_mm)
        return replace(without, surface_mm=self.surface_mm)

    @property
    def has_load(self) -> bool:
        """Return whether there is enough load for registration."""
        return float(self.load.mean()) >= _LEAST_SHARE


def compute_high_pass(height_mm: NDArray[np.float64], cell_mm: float, noise_mm: float) -> HighPassHeights:
    """Return the high-pass of a load (Ny, Nx), NaN where not measured; ``noise_mm`` is the empty belt's noise."""
    load = np.nan_to_num(height_mm, nan=-np.inf) > max(_LEAST_MM, 6 * noise_mm)
    # isolated cells are flying points, not load
    load &= ndimage.uniform_filter(load.astype(np.float32), 5) > 0.5
    value = np.where(load, height_mm, 0.0)
    blur = _SMOOTH_MM / cell_mm
    weight = ndimage.gaussian_filter(load.astype(np.float64), blur)
    mean = ndimage.gaussian_filter(value, blur) / np.maximum(weight, 1e-9)
    high_pass = np.where(load, value - mean, 0.0)
    spread = float(np.sqrt(np.mean(high_pass[load] ** 2))) if load.any() else 0.0
    high_pass = np.clip(high_pass, -_TALLEST * spread, _TALLEST * spread)
    return HighPassHeights(
        np.where(load, height_mm, np.nan), high_pass, load, cell_mm, height_mm.astype(np.float32)
    )


def compute_free_mm(frame: HighPassHeights, direction: int) -> float:
    """Return the length without load at the end of the view at which the belt leaves it.

    ``direction`` of travel is +1 towards +y, -1 towards -y.
    """
    rows = np.flatnonzero(frame.load.any(axis=1))
    count = len(frame.load)
    if not len(rows):
        return count * frame.cell_mm
    return float((count - 1 - rows[-1] if direction > 0 else rows[0]) * frame.cell_mm)
