"""Messages in C++."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_hear import hear_input


class Messages:
    """The kernel of native/bind_hear.cpp."""

    _module: ModuleType

    def hear(
        self,
        said: NDArray[np.floating],
        near: NDArray[np.int32],
        kept: NDArray[np.floating],
        layers: Sequence[NDArray[np.floating]],
        *,
        threads: int = 0,
    ) -> NDArray[np.float32]:
        """See `beltscape.kernels.protocol.hear`."""
        given = hear_input(said, near, kept, layers)
        out = np.empty((len(given.layers[-1]), given.near.shape[1]), np.float32)
        self._module.hear(*given, out, threads)
        return out
