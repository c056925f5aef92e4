"""Triangulation: points from their pixels in several cameras."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.backend import KernelFamily


class TriangulationInput(NamedTuple):
    """Checked input of `triangulate`."""

    projections: NDArray[np.float64]
    """(n, 3, 4)"""
    pixels: NDArray[np.float64]
    """(n, N, 2)"""


class TriangulationKernels(KernelFamily):
    """Kernel of points from rays."""

    def triangulate(
        self, projections: NDArray[np.floating], pixels: NDArray[np.floating], *, threads: int = 0
    ) -> NDArray[np.float64]:
        """Return N points seen by any subset of n cameras, in the least-squares sense.

        Parameters
        ----------
        projections
            (n, 3, 4) projection matrices, frame in mm → undistorted pixels.
        pixels
            (n, N, 2) undistorted pixels; NaN where a camera does not see the point.
        threads
            How many threads; 0 takes all cores. The result does not depend on it.

        Returns
        -------
        (N, 3) points in mm; NaN where fewer than two cameras see a point or their rays are parallel.

        Raises
        ------
        KernelError
            When the shapes do not fit each other.

        References
        ----------
        Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, Eqs. 2-3.
        """
        given = _checked(projections, pixels)
        (points,) = self._run("triangulate", given, (np.empty((given.pixels.shape[1], 3)),), threads)
        return points


def _checked(projections: NDArray[np.floating], pixels: NDArray[np.floating]) -> TriangulationInput:
    """Return contiguous float64 (n, 3, 4) projections and (n, N, 2) pixels, or raise KernelError."""
    projections = np.ascontiguousarray(projections, dtype=np.float64)
    pixels = np.ascontiguousarray(pixels, dtype=np.float64)
    if projections.ndim != 3 or projections.shape[1:] != (3, 4):
        raise KernelError(f"projections must have the shape (n, 3, 4), not {projections.shape}")
    if pixels.ndim != 3 or pixels.shape[2] != 2 or pixels.shape[0] != projections.shape[0]:
        raise KernelError(
            f"pixels must have the shape ({projections.shape[0]}, N, 2) for {projections.shape[0]} cameras, "
            f"not {pixels.shape}"
        )
    return TriangulationInput(projections, pixels)
