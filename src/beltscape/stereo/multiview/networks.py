"""Perceptrons with named features, loaded from the package's data."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels

Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class FeatureNetwork:
    """The weights of a perceptron, in the units of its features."""

    names: tuple[str, ...]
    """Of the features, in order."""
    limits: Array
    """(2, n) range to which features are clipped."""
    layers: tuple[Array, ...]
    """(k, n + 1) each: weights and offset of k units."""

    def evaluate(
        self, features: Mapping[str, NDArray[np.floating]], kernels: Kernels, threads: int
    ) -> list[Array]:
        """Return the m outputs (H, W) for features (H, W) by name."""
        planes = [features[name] for name in self.names]
        outputs = kernels.evaluate_network(planes, self.limits, self.layers, threads=threads)
        return [np.asarray(output, np.float32) for output in outputs]


@cache
def load_network(name: str) -> FeatureNetwork:
    """Return shipped weights, which tools/train_confidence.py and train_refinement.py fit to simulated frames.

    ``fast_confidence`` and ``confidence`` give the logit of the confidence and the logarithm of sigma in px of s,
    ``initial_confidence`` the first alone. ``candidates`` gives the logit of a candidate's probability,
    ``pairwise_ranking`` those of two. ``refinement`` gives a state for `confidence.message_passing`.
    """
    text = (files("beltscape") / "data" / f"{name}.json").read_text(encoding="utf-8")
    stored = json.loads(text)
    return FeatureNetwork(
        tuple(stored["names"]), _read_array(stored["limits"]), tuple(map(_read_array, stored["layers"]))
    )


def _read_array(rows: Sequence[Sequence[float]]) -> Array:
    return np.array(rows, np.float32)
