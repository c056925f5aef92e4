"""The protocol of the perceptron: evidence weighed pixel by pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Weighs(Protocol):
    """A small network of rectified layers, at every pixel."""

    def perceptron(
        self,
        planes: Sequence[NDArray[np.floating]],
        limits: NDArray[np.floating],
        layers: Sequence[NDArray[np.floating]],
        *,
        threads: int = 0,
    ) -> Sequence[NDArray[np.floating]]:
        """Answers of a network to each pixel's evidence x.

            x₀ = min(max(x, low), high),  xᵢ₊₁ = max(0, Wᵢ xᵢ + wᵢ),  out = the last layer's W x + w


        Parameters
        ----------
        planes
            n of (H, W), at most 256: the evidence. NaN counts as ``low``.
        limits
            (2, n): low, then high.
        layers
            (k, n + 1), each of at most 256 units k: W and in its last column w; n is the k of the layer before.

        Returns
        -------
        Of (H, W) float32, one per unit of the last layer.

        References
        ----------
        Rumelhart, Hinton & Williams, Nature 323, 533–536, 1986, doi:10.1038/323533a0.
        """
        ...
