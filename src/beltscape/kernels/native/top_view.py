"""The view from above in C++."""

from __future__ import annotations

from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_top_view import top_view_input
from beltscape.kernels.protocol.top_view import TopView


class Survey:
    """The kernel of native/bind_top_view.cpp."""

    _module: ModuleType

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
        """See `beltscape.kernels.protocol.top_view`."""
        del threads  # one is fast enough
        given = top_view_input(depth, sigma, use, grid_from_pixel, step, shape)
        out = TopView(np.empty(shape), np.empty(shape))
        self._module.top_view(*given, *out)
        return out
