"""The reference of `first_met`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_windows import first_met_input
from beltscape.kernels.protocol.first_met import Met, Place


def first_met(
    measured: NDArray[np.bool_],
    place: Place,
    down: NDArray[np.floating],
    across: NDArray[np.floating],
    most: int,
    *,
    threads: int = 0,
) -> Met:
    """See `beltscape.kernels.protocol.first_met`; ``threads`` is ignored here."""
    del threads
    given = first_met_input(measured, place, down, across, most)
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
        met = going & given.measured.ravel()[flat]
        cell[met], steps[met] = flat[met], step
        going &= ~met
    return Met(cell, steps)
