"""Ray march step by step: the reference of `first_hits`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.geometry.ray_march import RayMarchInput


def first_hits(given: RayMarchInput) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return cell and steps, (D, H) each."""
    rows, columns = given.measured.shape
    shape = (len(given.down), len(given.rows))
    cell, steps = np.full(shape, -1, np.int64), np.full(shape, np.inf)
    going = np.ones(shape, bool)
    for step in range(1, given.most + 1):
        row = given.rows + np.rint(step * given.down).astype(np.int64)
        column = given.columns + np.rint(step * given.across).astype(np.int64)
        going &= (row >= 0) & (column >= 0) & (row < rows) & (column < columns)
        if not going.any():
            break
        flat = np.where(going, row * columns + column, 0)
        hit = going & given.measured.ravel()[flat]
        cell[hit], steps[hit] = flat[hit], step
        going &= ~hit
    return cell, steps
