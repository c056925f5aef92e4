"""The protocol of triangulation: points from rays."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Triangulates(Protocol):
    """Points from rays."""

    def triangulate(
        self, projections: NDArray[np.float64], pixels: NDArray[np.float64], *, threads: int = 0
    ) -> NDArray[np.float64]:
        """N points seen by any subset of n cameras, in the least-squares sense.

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
        ...
