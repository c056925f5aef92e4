"""The protocol of lines that end at the first cell of a kind."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Place = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Rows and columns of cells, (H,) each."""


class Met(NamedTuple):
    """Where D lines from each of H places end."""

    cell: NDArray[np.int64]
    """(D, H) flat index of the cell, -1 where there is none."""
    steps: NDArray[np.float64]
    """(D, H) to it, inf where there is none."""


class Marches(Protocol):
    """Lines over a grid."""

    def first_met(
        self,
        measured: NDArray[np.bool_],
        place: Place,
        down: NDArray[np.floating],
        across: NDArray[np.floating],
        most: int,
        *,
        threads: int = 0,
    ) -> Met:
        """The first measured cell along lines from places.

        From cell (r, c) the k-th step leads to (r + rint(k down), c + rint(k across)), rint to the nearest whole
        number, of two to the even one; the first is k = 1.

        Parameters
        ----------
        measured
            (Ny, Nx).
        place
            (H,) rows and columns, within the grid.
        down, across
            (D, H) rows and columns a step, or (D, 1) the same from all places; -1 to 1.
        most
            Steps, at least 0.

        Returns
        -------
        Met of (D, H).

        References
        ----------
        J. C. Hart, Sphere tracing, The Visual Computer 12, 527–545, 1996, doi:10.1007/s003710050084: a step may be
        as long as the nearest measured cell is far.
        """
        ...
