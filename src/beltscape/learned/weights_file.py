"""The form of a network on disk: a NumPy archive (.npz) of its features' names, limits and layers.

=============  ======================================================================
``features``   (n,) names, in order
``outputs``    (m,) names, in order
``limits``     (2, n) float32: least and largest value of each feature
``layer_0`` …  (k, n + 1) float32 each: weights and, in the last column, offsets
=============  ======================================================================
"""

from __future__ import annotations

from pathlib import Path
from typing import IO

import numpy as np

from beltscape.core.errors import InputError
from beltscape.files.arrays import parse_arrays
from beltscape.learned.network import Network


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
