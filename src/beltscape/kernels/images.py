"""Kernels of images: gathering, warping, and statistics of square windows.

Planes are gathered at offsets from given pixels; an auxiliary's image is warped to where it sees the core's pixels;
statistics of windows about given cells are quadratics, means, minima and slopes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import CellIndices, cell_indices, float32, pixel_indices, spline
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.projection import PROJECTION_SIZE


class GatherInput(NamedTuple):
    """Checked input of `gather`."""

    planes: list[NDArray[np.float32]]
    """P of (H, W)"""
    u: NDArray[np.float32]
    """(N,)"""
    v: NDArray[np.float32]
    """(N,)"""
    offsets: NDArray[np.int32]
    """(K, 2)"""


class GatheringKernels(KernelFamily):
    """Kernels that read planes at offsets from given pixels."""

    def gather(
        self,
        planes: Sequence[NDArray[np.floating]],
        u: NDArray[np.integer],
        v: NDArray[np.integer],
        offsets: NDArray[np.integer],
        *,
        threads: int = 0,
    ) -> NDArray[np.floating]:
        """Return the planes' values at (u + du, v + dv), or at the nearest pixel of their edge.

        Parameters
        ----------
        planes
            P of (H, W).
        u, v
            (N,) columns and rows.
        offsets
            (K, 2) du, dv.

        Returns
        -------
        (P, K, N) float32.
        """
        if not planes:
            raise KernelError("planes must be at least one")
        first = float32("planes[0]", planes[0], ("H", "W"))
        checked = [float32(f"planes[{i}]", plane, first.shape) for i, plane in enumerate(planes)]
        if offsets.ndim != 2 or offsets.shape[1] != 2 or offsets.dtype.kind not in "iu":
            raise KernelError(f"offsets must be (K, 2) integers, not {offsets.dtype} {offsets.shape}")
        given = GatherInput(
            checked, *pixel_indices(u, v, first.shape), np.ascontiguousarray(offsets, np.int32)
        )
        out = np.empty((len(checked) * len(offsets), len(given.u)), np.float32)
        (values,) = self._run("gather", given, (out,), threads)
        return values.reshape(len(checked), len(offsets), -1)


class SplineInput(NamedTuple):
    """Checked input of `spline_coefficients`."""

    image: NDArray[np.float32]
    """(h, w)"""


class WarpInput(NamedTuple):
    """Checked input of `warp`."""

    s: NDArray[np.float32]
    """(H, W)"""
    view: NDArray[np.float32]
    """(39,)"""
    coefficients: NDArray[np.float32]
    """(h, w)"""


class WarpingKernels(KernelFamily):
    """Kernels of cubic splines of images, and of their values where the core's pixels are seen."""

    def spline_coefficients(self, image: NDArray[np.floating], *, threads: int = 0) -> NDArray[np.floating]:
        """Return the coefficients of the cubic B-spline that passes through an image.

        Beyond its edges the image is mirrored about the centres of its outermost pixels (SciPy's ``mirror``).

        Parameters
        ----------
        image
            (h, w) finite grey values.

        Returns
        -------
        (h, w) float32 coefficients.

        References
        ----------
        Unser, Aldroubi & Eden, IEEE Trans. Signal Process. 41(2), 821–833, 1993, doi:10.1109/78.193221.
        """
        given = SplineInput(float32("image", image, ("h", "w")))
        (coefficients,) = self._run("spline_coefficients", given, (np.empty_like(given.image),), threads)
        return coefficients

    def warp(
        self,
        s: NDArray[np.floating],
        view: NDArray[np.floating],
        coefficients: NDArray[np.floating],
        *,
        threads: int = 0,
    ) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Return an auxiliary's grey value for each of the core's pixels, and its derivative by inverse depth.

        Parameters
        ----------
        s
            (H, W) inverse depth on the core's undistorted grid; NaN where there is none.
        view
            (39,) how the auxiliary sees the core's pixels, as native/view.hpp lays it out.
        coefficients
            (h, w) of the auxiliary's image, at least 4 × 4, from `spline_coefficients`.

        Returns
        -------
        value
            (H, W) float32; NaN where s is NaN, the point is not before the auxiliary or the 4 × 4 coefficients
            about its pixel are not all in the image: 1 ≤ u < w - 2 and 1 ≤ v < h - 2 are needed.
        slope
            (H, W) float32, derivative of the value by s; 0 where the value is NaN.
        """
        packed = float32("view", view, (PROJECTION_SIZE,))
        given = WarpInput(float32("s", s, ("H", "W")), packed, spline(coefficients))
        value, slope = self._run("warp", given, (np.empty_like(given.s), np.empty_like(given.s)), threads)
        return value, slope


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


class BendsInput(NamedTuple):
    """Checked input of `bend_medians`."""

    field: NDArray[np.float64]
    """(Ny, Nx)"""
    halves: NDArray[np.int64]
    """(K,)"""
    above: float


class BendMedians(NamedTuple):
    """Bends of a field at K distances."""

    count: NDArray[np.int64]
    """(K,) number of bends."""
    median: NDArray[np.float64]
    """(K,) their median; NaN without any."""


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

    def bend_medians(
        self, field: NDArray[np.float64], halves: Sequence[int], above: float, *, threads: int = 0
    ) -> BendMedians:
        """Return the medians of the bends at the distances ``halves``, along both axes together.

        A cell's bend is the distance of its value from the mean of the two cells ``half`` cells before and after it,
        all three measured, and its own value greater than ``above``.
        """
        given = BendsInput(_checked_field(field), np.array(halves, np.int64), float(above))
        if (given.halves < 1).any():
            raise KernelError(f"halves must be at least 1, not {given.halves.tolist()}")
        out = np.empty(len(halves), np.int64), np.empty(len(halves))
        return BendMedians(*self._run("bend_medians", given, out, threads))


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
