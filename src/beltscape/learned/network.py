"""A multilayer perceptron with named features and outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels, load

Array = NDArray[np.float32]

LOG_VARIANCE = (-12.0, 3.0)
"""Limits to which a predicted logarithm of a variance is clipped: σ from 0.0025 to 4.5 of its unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The weights of a perceptron, in the units of its features.

    It has rectifiers between its layers and none behind the last (Rumelhart, Hinton & Williams, Nature 323, 533–536,
    1986, doi:10.1038/323533a0).
    """

    features: tuple[str, ...]
    """Names of the n features, in order."""
    outputs: tuple[str, ...]
    """Names of the m outputs, in order."""
    limits: Array
    """(2, n) least and largest value to which each feature is clipped."""
    layers: tuple[Array, ...]
    """(k, n + 1) each: weights and, in the last column, offset of k units."""

    @property
    def parameters(self) -> int:
        """Return the number of weights and offsets."""
        return sum(layer.size for layer in self.layers)

    def evaluate(
        self,
        features: Mapping[str, NDArray[np.floating]],
        kernels: Kernels | None = None,
        threads: int = 1,
        out: Sequence[Array] | None = None,
    ) -> list[Array]:
        """Return the m outputs (H, W) for features (H, W) by name; NaN counts as a feature's least value.

        They are written into ``out``, m contiguous arrays (H, W), where it is given.
        """
        planes = [features[name] for name in self.features]
        outputs = (kernels or load()).evaluate_network(
            planes, self.limits, self.layers, threads=threads, out=out
        )
        return [np.asarray(output, np.float32) for output in outputs]

    def evaluate_values(self, features: Mapping[str, NDArray[np.floating]]) -> NDArray[np.float64]:
        """Return the outputs (m, N) for features (N,) by name."""
        rows = {name: np.asarray(features[name], np.float32)[None] for name in self.features}
        return np.concatenate(self.evaluate(rows)).astype(np.float64)

    def predict_mean_and_sigma(
        self, features: Mapping[str, NDArray[np.floating]]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return mean and σ (N,) each, of a network whose outputs are a mean and the logarithm of a variance."""
        mean, log_variance = self.evaluate_values(features)
        return mean, np.exp(0.5 * np.clip(log_variance, *LOG_VARIANCE))


def compute_probability(logit: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the probability of a logit, limited to ±30."""
    return np.asarray(1 / (1 + np.exp(-np.clip(logit, -30, 30))), np.float32)
