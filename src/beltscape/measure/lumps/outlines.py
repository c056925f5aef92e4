"""How likely a cell lies on a lump's outline, and on a lump at all: a small network over the cell's features.

Its weights were fitted to simulated heaps (tools/fit_lumps.py) and are in data/lumps.json.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.lumps.features import features
from beltscape.measure.lumps.raster import Raster

_ROWS = 64


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Layers of weights with rectifiers between them; logistic at the end."""

    mean: NDArray[np.float32]
    """(F,) of the features."""
    scale: NDArray[np.float32]
    """(F,) their standard deviation."""
    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    """(weights (inputs, outputs), offsets (outputs,)) of each layer."""

    def __call__(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """(N, 2) probabilities from features (N, F)."""
        values = (values - self.mean) / self.scale
        for weights, offsets in self.layers[:-1]:
            values = np.maximum(values @ weights + offsets, 0)
        weights, offsets = self.layers[-1]
        return np.asarray(1 / (1 + np.exp(-np.clip(values @ weights + offsets, -30, 30))), np.float32)


def outlines(raster: Raster, network: Network | None = None) -> NDArray[np.float32]:
    """(R, C, 2) float32: probability of an outline, and of a lump (as against fines, belt and floor)."""
    network = network or fitted()
    values = features(raster.height_px, raster.measured)
    rows, columns, number = values.shape
    # in strips that stay in the processor's cache
    strips = [
        network(values[top : top + _ROWS].reshape(-1, number)).reshape(-1, columns, 2)
        for top in range(0, rows, _ROWS)
    ]
    return np.concatenate(strips)


@cache
def fitted() -> Network:
    """The network that ships with Beltscape."""
    path = files("beltscape") / "data" / "lumps.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    return Network(
        _array(document["mean"]),
        _array(document["scale"]),
        tuple((_array(layer["weights"]), _array(layer["offsets"])) for layer in document["layers"]),
    )


def _array(values: object) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)
