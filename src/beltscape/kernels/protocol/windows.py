"""The protocol of what square windows about places tell."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.protocol.first_met import Place

BAND_ROWS = 128
"""Rows whose places share a table of running sums: it stays small, and so does what rounding adds up to."""
TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Powers of x and y in a quadratic."""
FEWEST = 12
"""Cells that its six coefficients need."""
MOST_LEVERAGE = 30.0
"""Variance of the value, times the number of cells, of one cell's; from here on it is extrapolated too far."""
RIDGE = 1e-6
"""Share of the cells that keeps cells all on a line from carrying one, above what is lost by rounding."""
LEAST_SHARE = 1e-3
"""A window of which less is measured tells nothing."""
SLOPE_SIDE = 7
"""Cells across the window in which a plane is fitted."""
LEAST_SPREAD = 1e-3
"""Cells closer to a line than this (1 - correlation² of their places) carry no plane."""


class Quadratics(NamedTuple):
    """Least-squares quadratics in windows of K sizes about H places, NaN where the cells do not carry one."""

    value: NDArray[np.float64]
    """(K, H) at the place itself."""
    miss: NDArray[np.float64]
    """(K, H) root mean square by which the measured cells of the window miss it: 0 on a smooth surface."""
    leverage: NDArray[np.float64]
    """(K, H) variance of the value in units of one cell's over their number: 1 for a mean, much if extrapolated."""


class Means(NamedTuple):
    """Of windows of K sizes about H places."""

    share: NDArray[np.float64]
    """(K, H) of measured cells."""
    mean: NDArray[np.float64]
    """(K, H) of what they measured; NaN where next to nothing is."""


class Gathers(Protocol):
    """Sums, fits and minima in windows of odd ``sides`` about ``place`` of a ``field`` (Ny, Nx), NaN: not measured.

    Running sums: F. C. Crow, Summed-area tables for texture mapping, SIGGRAPH 1984, doi:10.1145/800031.808600.
    """

    def quadratics(
        self, field: NDArray[np.float64], place: Place, sides: tuple[int, ...], *, threads: int = 0
    ) -> Quadratics:
        """Quadratics through the measured cells of each window, by normal equations; outside of the field is nothing.

        Fields should lie about 0: their squares are summed.
        """
        ...

    def window_means(
        self, field: NDArray[np.float64], place: Place, sides: tuple[int, ...], *, threads: int = 0
    ) -> Means:
        """Means of the measured cells; the field's border goes on outside."""
        ...

    def window_minima(
        self, field: NDArray[np.float64], place: Place, sides: tuple[int, ...], *, threads: int = 0
    ) -> NDArray[np.float64]:
        """(K, H) least measured values; NaN where there is none."""
        ...

    def plane_slopes(self, field: NDArray[np.float64], *, threads: int = 0) -> NDArray[np.float64]:
        """(2, Ny, Nx) slope in x and y, per cell, of the plane through the measured cells about each measured one.

        The window is of `SLOPE_SIDE`; 0 where fewer than its side were measured, or all on a line.
        """
        ...
