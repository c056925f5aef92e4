"""Splines and warps in C++."""

from __future__ import annotations

from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check import float32, spline


class Warping:
    """The kernels of native/bind_warp.cpp."""

    _module: ModuleType

    def spline_coefficients(self, image: NDArray[np.floating], *, threads: int = 0) -> NDArray[np.float32]:
        """See `beltscape.kernels.protocol.warping`."""
        image = float32("image", image, ("h", "w"))
        out = np.empty_like(image)
        self._module.spline_coefficients(image, out, threads)
        return out

    def warp(
        self,
        s: NDArray[np.floating],
        view: NDArray[np.floating],
        coefficients: NDArray[np.floating],
        *,
        threads: int = 0,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """See `beltscape.kernels.protocol.warping`."""
        s, view = float32("s", s, ("H", "W")), float32("view", view, (21,))
        value, slope = np.empty_like(s), np.empty_like(s)
        self._module.warp(s, view, spline(coefficients), value, slope, threads)
        return value, slope
