"""Quadratic surfaces through the measured cells about places: how a smooth surface would go on there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import load
from beltscape.kernels.arrays import CellIndices


@dataclass(frozen=True, slots=True, eq=False)
class Quadrics:
    """Least-squares quadratics in windows of K sizes about H places, NaN where the cells do not carry one."""

    value_mm: NDArray[np.float64]
    """(K, H) at the place itself."""
    miss_mm: NDArray[np.float64]
    """(K, H) root mean square by which the measured cells of the window miss it: 0 on a smooth surface."""
    leverage: NDArray[np.float64]
    """(K, H) variance of the value in units of one cell's over their number: 1 for a mean, much if extrapolated."""


def quadrics(value_mm: NDArray[np.float64], place: CellIndices, sides: tuple[int, ...]) -> Quadrics:
    """Fit the measured cells of a field (Ny, Nx) in windows of odd ``sides`` cells about places (row, column)."""
    # about the field's own middle, so that squares do not drown in rounding
    middle = float(np.nanmean(value_mm))
    found = load().quadratics(value_mm - middle, place, sides)
    return Quadrics(found.value + middle, found.miss, found.leverage)
