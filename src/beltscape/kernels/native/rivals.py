"""Rivals and likenesses in C++."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_rivals import likenesses_input, rivals_input
from beltscape.kernels.protocol.rivals import RIVALS, Likenesses, Rivals


class Contest:
    """The kernels of native/bind_rivals.cpp."""

    _module: ModuleType

    def rivals(
        self,
        s: NDArray[np.floating],
        slope_u: NDArray[np.floating],
        slope_v: NDArray[np.floating],
        trusted: NDArray[np.uint8],
        u: NDArray[np.integer],
        v: NDArray[np.integer],
        *,
        reach: int,
        same: float,
        threads: int = 0,
    ) -> Rivals:
        """See `beltscape.kernels.protocol.rivals`."""
        given = rivals_input(s, slope_u, slope_v, trusted, u, v, reach, same)
        out = Rivals(*(np.empty((RIVALS, len(given.u)), np.float32) for _ in Rivals._fields))
        self._module.rivals(*given, list(out), threads)
        return out

    def likenesses(
        self,
        u: NDArray[np.integer],
        v: NDArray[np.integer],
        s: NDArray[np.floating],
        slope_u: NDArray[np.floating],
        slope_v: NDArray[np.floating],
        *,
        core: NDArray[np.floating],
        variance: NDArray[np.floating],
        images: Sequence[NDArray[np.floating]],
        views: NDArray[np.floating],
        buffers: Sequence[NDArray[np.floating]],
        gains: Sequence[NDArray[np.floating]],
        tolerance: float,
        threads: int = 0,
    ) -> Likenesses:
        """See `beltscape.kernels.protocol.rivals`."""
        given = likenesses_input(
            u, v, (s, slope_u, slope_v), core=core, variance=variance, images=images, views=views,
            buffers=buffers, gains=gains, tolerance=tolerance,
        )  # fmt: skip
        shape = given.planes[0].shape
        out = np.empty((len(Likenesses._fields), *shape), np.float32)
        self._module.likenesses(*given, out.reshape(-1, shape[1]), threads)
        return Likenesses(*out)
