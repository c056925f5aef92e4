"""Small networks of rectified layers, fitted by Adam (Kingma & Ba 2015, arXiv:1412.6980); for the other tools."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

Layers = list[list[np.ndarray]]
"""[weights (inputs, outputs), offsets (outputs,)] of each layer, float32."""
Slopes = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From outputs (B, outputs) of a batch and the samples' indices (B,): the loss's slope by each output."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """How long and how fast."""

    hidden: tuple[int, ...]
    epochs: int
    batch: int
    rate: float = 3e-3
    decay: float = 0.0
    """Of the weights, added to their slopes."""
    first: float = 1.0
    """Size of the last layer's weights at the start, in the usual one."""


def fitted(x: np.ndarray, outputs: int, slopes: Slopes, how: Schedule, rng: np.random.Generator) -> Layers:
    """Layers of least loss over samples x (N, F), the last one linear."""
    sizes = (x.shape[1], *how.hidden, outputs)
    layers = [
        [(rng.normal(size=(a, b)) * np.sqrt(2 / a)).astype(np.float32), np.zeros(b, np.float32)]
        for a, b in pairwise(sizes)
    ]
    layers[-1][0] *= np.float32(how.first)
    mean = [[np.zeros_like(part) for part in layer] for layer in layers]
    square = [[np.zeros_like(part) for part in layer] for layer in layers]
    batches = len(x) // how.batch
    order = rng.permutation(len(x))
    for step in range(how.epochs * batches):
        if step % batches == 0:
            order = rng.permutation(len(x))
        rate = how.rate * 0.5 * (1 + np.cos(np.pi * step / (how.epochs * batches))) + 1e-5
        at = order[step % batches * how.batch :][: how.batch]
        values = [x[at]]
        for weights, offsets in layers:
            put = values[-1] @ weights + offsets
            values.append(np.maximum(put, 0) if len(values) < len(layers) else put)
        back = slopes(values[-1], at)
        for k in range(len(layers) - 1, -1, -1):
            own = (values[k].T @ back + np.float32(how.decay) * layers[k][0], back.sum(axis=0))
            back = (back @ layers[k][0].T) * (values[k] > 0)
            for part, slope in enumerate(own):
                mean[k][part] += 0.1 * (slope - mean[k][part])
                square[k][part] += 0.01 * (slope**2 - square[k][part])
                first, second = (
                    mean[k][part] / (1 - 0.9 ** (step + 1)),
                    square[k][part] / (1 - 0.99 ** (step + 1)),
                )
                layers[k][part] -= (rate * first / (np.sqrt(second) + 1e-8)).astype(np.float32)
    return layers
