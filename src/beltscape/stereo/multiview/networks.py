"""The fitted networks that turn evidence into belief: of pixels, and of the surfaces that compete for one."""

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
    """A perceptron's weights, in its evidence's own units."""

    names: tuple[str, ...]
    """Of the evidence, in order."""
    limits: Array
    """(2, n) beyond which evidence says no more."""
    layers: tuple[Array, ...]
    """(k, n + 1) each; the last one's answers are the network's."""

    def answers(
        self, evidence: Mapping[str, NDArray[np.floating]], kernels: Kernels, threads: int
    ) -> list[Array]:
        """M of (H, W), of evidence (H, W) by name."""
        planes = [evidence[name] for name in self.names]
        found = kernels.evaluate_network(planes, self.limits, self.layers, threads=threads)
        return [np.asarray(answer, np.float32) for answer in found]


@cache
def load_network(name: str) -> FeatureNetwork:
    """Weights that ship: what tools/fit_belief.py and fit_scrutiny.py made of simulated frames with known truth.

    ``glance`` and ``belief`` answer with the logit of the confidence and the logarithm of sigma in px of s,
    ``impression`` with the first alone; ``rivals`` with the logit of a rival's being right, ``duel`` with those of
    two, ``scrutiny`` with a state (`beltscape.stereo.multiview.confidence.message_passing`).
    """
    kept = json.loads((files("beltscape") / "data" / f"{name}.json").read_text(encoding="utf-8"))
    return FeatureNetwork(tuple(kept["names"]), _array(kept["limits"]), tuple(map(_array, kept["layers"])))


def _array(rows: Sequence[Sequence[float]]) -> Array:
    return np.array(rows, np.float32)
