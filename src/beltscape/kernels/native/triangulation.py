"""`triangulate` in C++."""

from __future__ import annotations

from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check import triangulation_input


class Triangulation:
    """The kernel of native/bind_triangulate.cpp."""

    _module: ModuleType

    def triangulate(
        self, projections: NDArray[np.float64], pixels: NDArray[np.float64], *, threads: int = 0
    ) -> NDArray[np.float64]:
        """See `beltscape.kernels.protocol.triangulation`."""
        projections, pixels = triangulation_input(projections, pixels)
        out = np.empty((pixels.shape[1], 3))
        self._module.triangulate(projections, pixels, out, threads)
        return out
