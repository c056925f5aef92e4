"""Warping: an auxiliary's image sampled where it sees the core's pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.arrays import float32, spline
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.projection import PROJECTION_SIZE


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
