"""Neighbours in C++."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_neighbours import neighbours_input


class Neighbourhood:
    """The kernel of native/bind_neighbours.cpp."""

    _module: ModuleType

    def neighbours(
        self,
        planes: Sequence[NDArray[np.floating]],
        u: NDArray[np.integer],
        v: NDArray[np.integer],
        offsets: NDArray[np.integer],
        *,
        threads: int = 0,
    ) -> NDArray[np.float32]:
        """See `beltscape.kernels.protocol.neighbours`."""
        given = neighbours_input(planes, u, v, offsets)
        out = np.empty((len(given.planes) * len(given.offsets), len(given.u)), np.float32)
        self._module.neighbours(*given, out, threads)
        return out.reshape(len(given.planes), len(given.offsets), -1)
