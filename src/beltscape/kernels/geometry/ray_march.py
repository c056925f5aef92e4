"""Ray march over a grid: the first measured cell along lines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import CellIndices, cell_indices
from beltscape.kernels.backend import KernelFamily


class FirstHits(NamedTuple):
    """End points of D lines from each of H cells."""

    cell: NDArray[np.int64]
    """(D, H) flat index of the cell, -1 where there is none."""
    steps: NDArray[np.float64]
    """(D, H) number of steps to it, inf where there is none."""


class RayMarchInput(NamedTuple):
    """Checked input of `first_hits`."""

    measured: NDArray[np.bool_]
    """(Ny, Nx)"""
    rows: NDArray[np.int64]
    """(H,)"""
    columns: NDArray[np.int64]
    """(H,)"""
    down: NDArray[np.float64]
    """(D, H) or (D, 1)"""
    across: NDArray[np.float64]
    """(D, H) or (D, 1)"""
    most: int


class RayMarchKernels(KernelFamily):
    """Kernels of lines over a grid."""

    def first_hits(
        self,
        measured: NDArray[np.bool_],
        cells: CellIndices,
        down: NDArray[np.floating],
        across: NDArray[np.floating],
        most: int,
        *,
        threads: int = 0,
    ) -> FirstHits:
        """Return the first measured cell along lines from given cells.

        From cell (r, c) the k-th step leads to (r + rint(k down), c + rint(k across)), from k = 1 on; rint rounds to
        the nearest whole number, and halves to the even one.

        Parameters
        ----------
        measured
            (Ny, Nx).
        cells
            (H,) rows and columns, within the grid.
        down, across
            (D, H) rows and columns per step, or (D, 1) the same from all cells; -1 to 1.
        most
            The largest number of steps, at least 0.

        Returns
        -------
        FirstHits of (D, H).

        References
        ----------
        J. C. Hart, Sphere tracing, The Visual Computer 12, 527–545, 1996, doi:10.1007/s003710050084 (a
        step may be as long as the distance to the nearest measured cell).
        """
        measured = np.ascontiguousarray(measured, dtype=bool)
        if measured.ndim != 2 or not measured.size:
            raise KernelError(f"measured must have the shape (Ny, Nx), not {measured.shape}")
        rows, columns = cell_indices(cells, measured.shape)
        down, across = (np.ascontiguousarray(part, dtype=np.float64) for part in (down, across))
        for name, part in (("down", down), ("across", across)):
            if part.ndim != 2 or part.shape[1] not in (1, len(rows)) or part.shape != down.shape:
                raise KernelError(f"{name} must have the shape (D, 1) or (D, {len(rows)}), not {part.shape}")
            if not (np.abs(part) <= 1).all():
                raise KernelError(f"{name} must be -1 to 1")
        if most < 0:
            raise KernelError(f"most must be at least 0, not {most}")
        given = RayMarchInput(measured, rows, columns, down, across, most)
        shape = len(down), len(rows)
        return FirstHits(
            *self._run("first_hits", given, (np.empty(shape, np.int64), np.empty(shape)), threads)
        )
