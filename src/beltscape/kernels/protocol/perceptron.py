"""The protocol of the perceptron: evidence weighed pixel by pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Weighs(Protocol):
    """A small network with one hidden layer, at every pixel."""

    def perceptron(
        self,
        planes: Sequence[NDArray[np.floating]],
        limits: NDArray[np.floating],
        hidden: NDArray[np.floating],
        output: NDArray[np.floating],
        *,
        threads: int = 0,
    ) -> Sequence[NDArray[np.floating]]:
        """Answers of a network to each pixel's evidence x.

            out = W max(0, V min(max(x, low), high) + v) + w


        Parameters
        ----------
        planes
            n of (H, W), at most 64: the evidence. NaN counts as ``low``.
        limits
            (2, n): low, then high.
        hidden
            (k, n + 1): V and in its last column v.
        output
            (m, k + 1), m at most 8: W and in its last column w.

        Returns
        -------
        m of (H, W) float32.

        References
        ----------
        Rumelhart, Hinton & Williams, Nature 323, 533–536, 1986, doi:10.1038/323533a0.
        """
        ...
