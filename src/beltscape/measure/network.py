"""Small fitted networks (multilayer perceptrons): their evaluation and their files."""

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
"""Limits to which the predicted logarithm of the variance is clipped."""
_DIGITS = 5
"""Digits of the weights in files; single precision has seven."""


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """A multilayer perceptron: layers of weights with rectifiers between them, linear at the end."""

    mean: NDArray[np.float32]
    """(F,) mean of the features."""
    scale: NDArray[np.float32]
    """(F,) standard deviation of the features."""
    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    """(weights (inputs, outputs), offsets (outputs,)) of each layer."""

    def __call__(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the outputs (N, outputs) for features (N, F)."""
        # the last digits of parallel sums depend on the number of threads; small products gain nothing by threads
        with _blas().limit(limits=1, user_api="blas"):
            values = (values - self.mean) / self.scale
            for weights, offsets in self.layers[:-1]:
                values = np.maximum(values @ weights + offsets, 0)
            weights, offsets = self.layers[-1]
            return values @ weights + offsets

    def predict_mean_and_sigma(
        self, values: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return mean and σ (N,) each, from outputs that are a mean and the logarithm of a variance."""
        found = self(values).astype(np.float64)
        return found[:, 0], np.exp(0.5 * np.clip(found[:, 1], *LOG_VARIANCE))

    def predict_probabilities(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return probabilities (N, outputs), from outputs that are logits."""
        return np.asarray(1 / (1 + np.exp(-np.clip(self(values), -30, 30))), np.float32)

    def to_document(self) -> dict[str, Any]:
        """Return the network as a JSON document, to five digits."""

        def plain(values: NDArray[np.float32]) -> Any:
            def shorten(value: np.float32) -> float:
                return float(f"{value:.{_DIGITS}g}")

            return np.vectorize(shorten)(values).tolist()

        layers = [{"weights": plain(weights), "offsets": plain(offsets)} for weights, offsets in self.layers]
        return {"mean": plain(self.mean), "scale": plain(self.scale), "layers": layers}


@cache
def _blas() -> ThreadpoolController:
    """Return the cached controller of the BLAS threads: finding the libraries takes a millisecond."""
    return ThreadpoolController()


@cache
def load_network(name: str) -> Network:
    """Return a network from Beltscape's data, by its file's name without .json."""
    text = (files("beltscape") / "data" / f"{name}.json").read_text(encoding="utf-8")
    document = json.loads(text)
    layers = tuple((_array(layer["weights"]), _array(layer["offsets"])) for layer in document["layers"])
    return Network(_array(document["mean"]), _array(document["scale"]), layers)


def _array(values: object) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)
