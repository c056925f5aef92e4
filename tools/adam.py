"""Small networks of rectified layers, fitted by Adam (Kingma & Ba 2015, arXiv:1412.6980); for the other tools."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

Layers = list[list[np.ndarray]]
"""[weights (inputs, outputs), offsets (outputs,)] of each layer, float32."""
Gradient = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From outputs (B, outputs) of a batch and the samples' indices (B,): the loss's derivative by each output."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """Hidden units, duration and learning rate of a fit."""

    hidden: tuple[int, ...]
    epochs: int
    batch: int
    rate: float = 3e-3
    decay: float = 0.0
    """Factor on the weights in their gradient (weight decay)."""
    last_scale: float = 1.0
    """Factor on the last layer's initial weights."""


def fit_layers(
    x: np.ndarray, outputs: int, gradient: Gradient, schedule: Schedule, rng: np.random.Generator
) -> Layers:
    """Return layers of least loss over samples x (N, F), the last one linear."""
    sizes = (x.shape[1], *schedule.hidden, outputs)
    layers = [
        [(rng.normal(size=(a, b)) * np.sqrt(2 / a)).astype(np.float32), np.zeros(b, np.float32)]
        for a, b in pairwise(sizes)
    ]
    layers[-1][0] *= np.float32(schedule.last_scale)
    mean = [[np.zeros_like(part) for part in layer] for layer in layers]
    square = [[np.zeros_like(part) for part in layer] for layer in layers]
    batch = min(schedule.batch, len(x))
    batches = len(x) // batch
    order = rng.permutation(len(x))
    for step in range(schedule.epochs * batches):
        if step % batches == 0:
            order = rng.permutation(len(x))
        rate = schedule.rate * 0.5 * (1 + np.cos(np.pi * step / (schedule.epochs * batches))) + 1e-5
        at = order[step % batches * batch :][:batch]
        values = [x[at]]
        for weights, offsets in layers:
            linear = values[-1] @ weights + offsets
            values.append(np.maximum(linear, 0) if len(values) < len(layers) else linear)
        back = gradient(values[-1], at)
        for k in range(len(layers) - 1, -1, -1):
            own = (values[k].T @ back + np.float32(schedule.decay) * layers[k][0], back.sum(axis=0))
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
