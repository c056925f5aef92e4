"""The protocol of neighbours: what lies about given pixels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class LooksAround(Protocol):
    """Planes at offsets from given pixels."""

    def neighbours(
        self,
        planes: Sequence[NDArray[np.floating]],
        u: NDArray[np.integer],
        v: NDArray[np.integer],
        offsets: NDArray[np.integer],
        *,
        threads: int = 0,
    ) -> NDArray[np.floating]:
        """What planes hold at (u + du, v + dv), or at their edge's next pixel where that leaves them.

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
        ...
