"""The protocol of warps: an auxiliary's image where the core's pixels are seen."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Warps(Protocol):
    """Cubic splines of images, and their values where the core's pixels are seen."""

    def spline_coefficients(self, image: NDArray[np.floating], *, threads: int = 0) -> NDArray[np.floating]:
        """Coefficients of the cubic B-spline that passes through an image.

        Beyond its edges the image goes on mirrored about the centres of its outermost pixels (SciPy's
        ``mirror``).

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
        ...

    def warp(
        self,
        s: NDArray[np.floating],
        view: NDArray[np.floating],
        coefficients: NDArray[np.floating],
        *,
        threads: int = 0,
    ) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Grey value of an auxiliary where it sees each of the core's pixels, and how it moves with nearness.

        Parameters
        ----------
        s
            (H, W) nearness on the core's undistorted grid; NaN where there is none.
        view
            (21,) how the auxiliary sees the core's pixels, as native/view.hpp lays it out.
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
        ...
