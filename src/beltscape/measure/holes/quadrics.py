"""Quadratic surfaces fitted to the measured cells around hole cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import load
from beltscape.kernels.arrays import CellIndices


@dataclass(frozen=True, slots=True, eq=False)
class Quadrics:
    """Least-squares quadratics in windows of K sizes around H cells, NaN where the window does not determine one."""

    value_mm: NDArray[np.float64]
    """(K, H) height at the window's centre."""
    rms_mm: NDArray[np.float64]
    """(K, H) root mean square residual of the measured cells of the window: 0 on a smooth surface."""
    leverage: NDArray[np.float64]
    """(K, H) variance of the value in units of one cell's over their number: 1 for a mean, large if extrapolated."""


def fit_quadrics(value_mm: NDArray[np.float64], cells: CellIndices, sides: tuple[int, ...]) -> Quadrics:
    """Fit the measured cells of a field (Ny, Nx) in windows of odd ``sides`` cells around cells (row, column)."""
    # relative to the field's mean, so that squares keep their precision
    middle = float(np.nanmean(value_mm))
    found = load().quadratics(value_mm - middle, cells, sides)
    return Quadrics(found.value + middle, found.miss, found.leverage)
