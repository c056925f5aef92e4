"""Kernels of images: gathering and warping.

Planes are gathered at offsets from given pixels; an auxiliary's image is warped to where it sees the core's pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import float32, pixel_indices, spline
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.expressions import GatherInput
from beltscape.kernels.projection import PROJECTION_SIZE


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
        (coefficients,) = self._run(
            "spline_coefficients", given, (np.empty(given.image.shape, np.float32),), threads
        )
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
        out = np.empty(given.s.shape, np.float32), np.empty(given.s.shape, np.float32)
        value, slope = self._run("warp", given, out, threads)
        return value, slope
