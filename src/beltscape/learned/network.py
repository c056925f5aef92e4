"""A multilayer perceptron with named features and outputs, and its form on disk.

On disk it is a NumPy archive (.npz) of its features' names, limits and layers:

=============  ======================================================================
``features``   (n,) names, in order
``outputs``    (m,) names, in order
``limits``     (2, n) float32: least and largest value of each feature
``layer_0`` …  (k, n + 1) float32 each: weights and, in the last column, offsets
=============  ======================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Float32Array
from beltscape.core.errors import InputError
from beltscape.files.arrays import parse_arrays
from beltscape.kernels import Kernels, load_on_processor
from beltscape.kernels.holes import LOG_VARIANCE


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
    limits: Float32Array
    """(2, n) least and largest value to which each feature is clipped."""
    layers: tuple[Float32Array, ...]
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
        out: Sequence[Float32Array] | None = None,
    ) -> list[Float32Array]:
        """Return the m outputs (H, W) for features (H, W) by name; NaN counts as a feature's least value.

        They are written into ``out``, m contiguous arrays (H, W), where it is given.
        """
        planes = [features[name] for name in self.features]
        outputs = (kernels or load_on_processor()).evaluate_network(
            planes, self.limits, self.layers, threads=threads, out=out
        )
        return [output.astype(np.float32, copy=False) for output in outputs]

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


def write_network(path: Path | IO[bytes], network: Network) -> None:
    """Write a network; the same network gives the same bytes."""
    layers = {f"layer_{i}": np.asarray(layer, np.float32) for i, layer in enumerate(network.layers)}
    np.savez(
        path,
        allow_pickle=False,
        features=np.array(network.features),
        outputs=np.array(network.outputs),
        limits=np.asarray(network.limits, np.float32),
        **layers,
    )


def read_network(stream: IO[bytes], name: str) -> Network:
    """Return the network in an open file, which is called ``name`` in errors.

    Raises
    ------
    InputError
        If the file is damaged, an array is missing, a number is not finite, or the layers fit neither each other nor
        the names of features and outputs.
    """
    arrays = parse_arrays(stream, name)
    layers = [f"layer_{i}" for i in range(max(1, sum(key.startswith("layer_") for key in arrays)))]
    missing = [key for key in ("features", "outputs", "limits", *layers) if key not in arrays]
    if missing:
        raise InputError(f"{name}: has no array {missing[0]}; it is no file of a network")
    network = Network(
        tuple(map(str, arrays["features"])),
        tuple(map(str, arrays["outputs"])),
        arrays["limits"].astype(np.float32),
        tuple(arrays[key].astype(np.float32) for key in layers),
    )
    _check(network, name)
    return network


def _check(network: Network, name: str) -> None:
    inputs = len(network.features)
    if network.limits.shape != (2, inputs):
        raise InputError(f"{name}: limits are {network.limits.shape}, but there are {inputs} features")
    for i, layer in enumerate(network.layers):
        if layer.ndim != 2 or layer.shape[1] != inputs + 1:
            raise InputError(f"{name}: layer_{i} is {layer.shape}; it must be (units, {inputs + 1})")
        inputs = layer.shape[0]
    numbers = {"limits": network.limits} | {f"layer_{i}": layer for i, layer in enumerate(network.layers)}
    for key, array in numbers.items():
        if not np.isfinite(array).all():
            raise InputError(f"{name}: {key} has a number that is not finite; the file is damaged")
    if inputs != len(network.outputs):
        raise InputError(
            f"{name}: the last layer has {inputs} units, but there are {len(network.outputs)} outputs"
        )
