"""The protocol of messages: what pixels make of what those about them say."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Hears(Protocol):
    """A round of messages between pixels."""

    def hear(
        self,
        said: NDArray[np.floating],
        near: NDArray[np.int32],
        kept: NDArray[np.floating],
        layers: Sequence[NDArray[np.floating]],
        *,
        threads: int = 0,
    ) -> NDArray[np.floating]:
        """Answers of a network to what those about a pixel say and what it keeps itself.

            x₀ = (said[0, near[0]], said[0, near[1]], …, said[K − 1, near[H − 1]], kept),
            xᵢ₊₁ = max(0, Wᵢ xᵢ + wᵢ),  out = the last layer's W x + w

        Parameters
        ----------
        said
            (K, A): a message of K words from each of A addresses.
        near
            (H, N): from which H addresses each of N pixels hears.
        kept
            (C, N): what each keeps.
        layers
            (k, n + 1), each of at most 256 units k: W and in its last column w; the first n is H K + C, at most 256.

        Returns
        -------
        (M, N) float32, a row per unit of the last layer.

        References
        ----------
        Gilmer, Schoenholz, Riley, Vinyals & Dahl, ICML 2017, arXiv:1704.01212; here messages are not summed.
        """
        ...
