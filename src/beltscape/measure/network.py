"""Small fitted networks: what they tell of features, and where they are kept."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

LOG_VARIANCE = (-12.0, 3.0)
"""Within these limits the logarithm of the variance counts."""
_DIGITS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Layers of weights with rectifiers between them, linear at the end."""

    mean: NDArray[np.float32]
    """(F,) of the features."""
    scale: NDArray[np.float32]
    """(F,) their standard deviation."""
    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    """(weights (inputs, outputs), offsets (outputs,)) of each layer."""

    def __call__(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """(N, outputs) answers to features (N, F)."""
        # parallel sums depend on the number of threads in their last digits, and small ones gain nothing by it
        with _blas().limit(limits=1, user_api="blas"):
            values = (values - self.mean) / self.scale
            for weights, offsets in self.layers[:-1]:
                values = np.maximum(values @ weights + offsets, 0)
            weights, offsets = self.layers[-1]
            return values @ weights + offsets

    def mean_and_sigma(self, values: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(N,) each: of answers that are a mean and the logarithm of a variance."""
        found = self(values).astype(np.float64)
        return found[:, 0], np.exp(0.5 * np.clip(found[:, 1], *LOG_VARIANCE))

    def chances(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """(N, outputs): of answers that are logits."""
        return np.asarray(1 / (1 + np.exp(-np.clip(self(values), -30, 30))), np.float32)

    def document(self) -> dict[str, Any]:
        """What JSON can hold of it, to five digits."""

        def plain(values: NDArray[np.float32]) -> Any:
            return np.vectorize(lambda value: float(f"{value:.{_DIGITS}g}"))(values).tolist()

        layers = [{"weights": plain(weights), "offsets": plain(offsets)} for weights, offsets in self.layers]
        return {"mean": plain(self.mean), "scale": plain(self.scale), "layers": layers}


@cache
def _blas() -> ThreadpoolController:
    """Finding the libraries takes a millisecond, limiting them microseconds."""
    return ThreadpoolController()


@cache
def shipped(name: str) -> Network:
    """A network that comes with Beltscape, by its file's name without .json."""
    text = (files("beltscape") / "data" / f"{name}.json").read_text(encoding="utf-8")
    document = json.loads(text)
    layers = tuple((_array(layer["weights"]), _array(layer["offsets"])) for layer in document["layers"])
    return Network(_array(document["mean"]), _array(document["scale"]), layers)


def _array(values: object) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)
