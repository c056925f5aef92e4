"""The perceptron in C++."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_perceptron import perceptron_input


class Perceptron:
    """The kernel of native/bind_perceptron.cpp."""

    _module: ModuleType

    def perceptron(
        self,
        planes: Sequence[NDArray[np.floating]],
        limits: NDArray[np.floating],
        layers: Sequence[NDArray[np.floating]],
        *,
        threads: int = 0,
    ) -> list[NDArray[np.float32]]:
        """See `beltscape.kernels.protocol.perceptron`."""
        given = perceptron_input(planes, limits, layers)
        out = [np.empty(given.planes[0].shape, np.float32) for _ in given.layers[-1]]
        self._module.perceptron(*given, out, threads)
        return out
