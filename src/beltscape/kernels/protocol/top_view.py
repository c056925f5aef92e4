"""The protocol of the view from above: a depth map's surface over a grid."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

EDGE = 1e-9
"""How far beyond a triangle's side, as a weight, a node still lies in it: one on a shared side belongs to both."""


class TopView(NamedTuple):
    """What lies uppermost over each node of a grid; NaN where nothing does."""

    height: NDArray[np.float64]
    """(Ny, Nx) in the units of the given transform's third row."""
    variance: NDArray[np.float64]
    """(Ny, Nx) of the depths there."""


class Surveys(Protocol):
    """Heights as seen from straight above."""

    def top_view(
        self,
        depth: NDArray[np.floating],
        sigma: NDArray[np.floating],
        use: NDArray[np.bool_],
        grid_from_pixel: NDArray[np.floating],
        step: float,
        shape: tuple[int, int],
        *,
        threads: int = 0,
    ) -> TopView:
        """Top surface of a depth map at the nodes of a grid; it runs on one thread.

        Neighbouring pixels of one surface are joined to triangles. A side joins two pixels whose depths differ by no
        more than ``step``, as float32; of a square's two diagonals the one from top right to bottom left is drawn
        where it joins, else the other, and a triangle is there where its three sides join. Over a node that lies
        within a triangle, to `EDGE`, both values are interpolated, the variance as the height. Of several triangles
        the highest counts, of equally high ones that with the largest variance: so what is vertical has no area, and
        what hangs over is solid.

        Parameters
        ----------
        depth, sigma
            (H, W) and its standard deviation.
        use
            (H, W) bool: which pixels take part, as far as their places, heights and variances are finite.
        grid_from_pixel
            (3, 4) a matrix A and a column b: pixel (u, v) of depth d lies at
            (column, row, height) = d A (u, v, 1) + b.
        step
            At least 0, in the units of the depth.
        shape
            (Ny, Nx) of the grid; nodes lie at whole columns and rows.

        Returns
        -------
        TopView of (Ny, Nx).
        """
        ...
