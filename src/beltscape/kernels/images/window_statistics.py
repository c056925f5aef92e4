"""Statistics of square windows about given cells of a field: quadratics, means, minima, slopes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import CellIndices, cell_indices
from beltscape.kernels.backend import KernelFamily

BAND_ROWS = 128
"""Rows whose cells share a table of running sums, so that the table and its rounding errors stay small."""
TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Powers of x and y in a quadratic."""
FEWEST = 12
"""Least number of cells of a quadratic: twice its six coefficients."""
MOST_LEVERAGE = 30.0
"""Limit of the leverage; a value with more is extrapolated too far. The networks of the holes were fitted with this
value."""
RIDGE = 1e-6
"""Ridge as a share of the cells, above the rounding errors: cells on one line determine no quadratic."""
LEAST_SHARE = 1e-3
"""A window with a smaller share of measured cells has no mean: ten cells of the largest window of 101 × 101."""
SLOPE_SIDE = 7
"""Side of the window in which a plane is fitted, cells. The networks of the holes were fitted with this value."""
LEAST_SPREAD = 1e-3
"""Least 1 - correlation² of the cells' positions; cells closer to a line than this determine no plane."""


class Quadratics(NamedTuple):
    """Least-squares quadratics in windows of K sizes about H cells, NaN where they are not determined."""

    value: NDArray[np.float64]
    """(K, H) at the cell itself."""
    miss: NDArray[np.float64]
    """(K, H) root mean square residual of the window's measured cells: 0 on a quadratic surface."""
    leverage: NDArray[np.float64]
    """(K, H) variance of the value times the number of cells, over one cell's: 1 for a mean, more beyond."""


class WindowMeans(NamedTuple):
    """Means in windows of K sizes about H cells."""

    share: NDArray[np.float64]
    """(K, H) of measured cells."""
    mean: NDArray[np.float64]
    """(K, H) of these; NaN where fewer than `LEAST_SHARE` are measured."""


class WindowsInput(NamedTuple):
    """Checked input of the windows about cells."""

    field: NDArray[np.float64]
    """(Ny, Nx)"""
    rows: NDArray[np.int64]
    """(H,)"""
    columns: NDArray[np.int64]
    """(H,)"""
    sides: NDArray[np.int64]
    """(K,)"""


class FieldInput(NamedTuple):
    """Checked input of `plane_slopes`."""

    field: NDArray[np.float64]
    """(Ny, Nx)"""


class WindowStatisticsKernels(KernelFamily):
    """Kernels of windows with odd ``sides`` about ``cells`` of a ``field`` (Ny, Nx), in which NaN is not measured.

    Running sums: F. C. Crow, Summed-area tables for texture mapping, SIGGRAPH 1984, doi:10.1145/800031.808600.
    """

    def quadratics(
        self, field: NDArray[np.float64], cells: CellIndices, sides: tuple[int, ...], *, threads: int = 0
    ) -> Quadratics:
        """Fit quadratics to the measured cells of each window by normal equations; nothing lies outside the field.

        Fields should have a mean near 0, because their squares are summed.
        """
        given = _checked_windows(field, cells, sides)
        out = np.empty((3, len(sides), len(given.rows)))
        return Quadratics(*self._run("quadratics", given, list(out), threads))

    def window_means(
        self, field: NDArray[np.float64], cells: CellIndices, sides: tuple[int, ...], *, threads: int = 0
    ) -> WindowMeans:
        """Return the means of the measured cells; the field's border is repeated outside."""
        given = _checked_windows(field, cells, sides)
        out = np.empty((2, len(sides), len(given.rows)))
        return WindowMeans(*self._run("window_means", given, list(out), threads))

    def window_minima(
        self, field: NDArray[np.float64], cells: CellIndices, sides: tuple[int, ...], *, threads: int = 0
    ) -> NDArray[np.float64]:
        """Return the (K, H) least measured values; NaN where there is none."""
        del threads  # one is fast enough
        given = _checked_windows(field, cells, sides)
        (least,) = self._run("window_minima", given, (np.empty((len(sides), len(given.rows))),), 1)
        return least

    def plane_slopes(self, field: NDArray[np.float64], *, threads: int = 0) -> NDArray[np.float64]:
        """Return (2, Ny, Nx) slopes in x and y, per cell, of the plane through the measured cells about each.

        The window's side is `SLOPE_SIDE`. Slopes are 0 where fewer cells than that are measured, or all on a line.
        """
        given = FieldInput(_checked_field(field))
        (slopes,) = self._run("plane_slopes", given, (np.empty((2, *given.field.shape)),), threads)
        return slopes


def _checked_windows(field: NDArray[np.floating], cells: CellIndices, sides: tuple[int, ...]) -> WindowsInput:
    """Return the checked input of windows about cells, or raise KernelError."""
    checked = _checked_field(field)
    if not sides or any(side < 1 or side % 2 == 0 for side in sides):
        raise KernelError(f"sides must be odd and positive, not {sides}")
    return WindowsInput(checked, *cell_indices(cells, checked.shape), np.array(sides, np.int64))


def _checked_field(field: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the field (Ny, Nx) as contiguous float64, or raise KernelError."""
    field = np.ascontiguousarray(field, dtype=np.float64)
    if field.ndim != 2 or not field.size:
        raise KernelError(f"field must have the shape (Ny, Nx), not {field.shape}")
    return field
