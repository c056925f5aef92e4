"""Fit of a multilayer perceptron by PyTorch, deterministic on the processor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from beltscape.learned.network import Network

Loss = Callable[[Tensor, Tensor], Tensor]
"""Mean loss of outputs (B, m) of the samples with indices (B,)."""
LIMIT = 4.0
"""Features are clipped to this many standard deviations around their mean."""
_SPREAD = 1e-6
"""Added to every standard deviation, for features that are constant."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """Hidden units, duration and learning rate of a fit."""

    hidden: tuple[int, ...]
    epochs: int
    batch: int
    rate: float = 3e-3
    decay: float = 1e-6
    """Weight decay; see `make_optimiser`."""


def set_deterministic(threads: int = 1) -> None:
    """Make every following fit depend on nothing but its input and its seed."""
    torch.use_deterministic_algorithms(True)
    torch.set_num_threads(threads)


def compute_limits(x: np.ndarray) -> np.ndarray:
    """Return the (2, n) limits to which features (N, n) are clipped; NaN is no value."""
    return np.stack([_limit_column(column) for column in x.T], axis=1).astype(np.float32)


def _limit_column(column: np.ndarray) -> tuple[float, float]:
    values = column[~np.isnan(column)]
    mean, spread = values.mean(dtype=float), values.std(dtype=float)
    return max(mean - LIMIT * spread, values.min()), min(mean + LIMIT * spread, values.max())


def _scale_columns(x: np.ndarray, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return features (N, n) clipped and scaled to mean 0 and spread 1, and their means and spreads (n,).

    One feature at a time, for the samples take gigabytes.
    """
    scaled = np.empty(x.shape, np.float32)
    mean, spread = np.empty(x.shape[1]), np.empty(x.shape[1])
    for i, (low, high) in enumerate(limits.T):
        within = np.clip(np.where(np.isnan(x[:, i]), low, x[:, i]), low, high)
        mean[i], spread[i] = within.mean(dtype=float), within.std(dtype=float) + _SPREAD
        scaled[:, i] = (within - mean[i]) / spread[i]
    return scaled, mean, spread


def make_layers(*sizes: int) -> nn.Sequential:
    """Return linear layers of these numbers of units, all but the last rectified."""
    layers = [part for a, b in pairwise(sizes) for part in (nn.Linear(a, b), nn.ReLU())]
    return nn.Sequential(*layers[:-1])


def export_layers(layers: nn.Sequential) -> list[np.ndarray]:
    """Return the (units, inputs + 1) weights and offsets of each layer."""
    linear = [layer for layer in layers if isinstance(layer, nn.Linear)]
    return [
        torch.cat([layer.weight, layer.bias[:, None]], 1).detach().numpy().astype(np.float64)
        for layer in linear
    ]


def unscale_first_layer(layer: np.ndarray, mean: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return a first layer for features in their own units from one for (features − mean) / spread."""
    weights = layer[:, :-1] / spread
    return np.hstack([weights, layer[:, -1:] - weights @ mean[:, None]])


def fit_perceptron(
    features: tuple[str, ...],
    outputs: tuple[str, ...],
    x: np.ndarray,
    loss: Loss,
    schedule: Schedule,
    *,
    limits: np.ndarray | None = None,
    start: float = 0.0,
    seed: int = 0,
) -> Network:
    """Return the network of least mean loss over samples x (N, n), by AdamW with a cosine schedule.

    ``limits`` (2, n) are those of `compute_limits` by default; ``start`` is added to the outputs before the fit.
    """
    torch.manual_seed(seed)
    limits = compute_limits(x) if limits is None else limits
    scaled, mean, spread = _scale_columns(x, limits)
    model = make_layers(len(features), *schedule.hidden, len(outputs))
    with torch.no_grad():
        for part in (model[-1].weight, model[-1].bias):
            part.mul_(0.3)  # the first outputs are near their start
    _descend(model, torch.from_numpy(scaled), lambda found, at: loss(found + start, at), schedule)
    first, *others = export_layers(model)
    layers = [unscale_first_layer(first, mean, spread), *others]
    layers[-1][:, -1] += start
    return Network(features, outputs, limits, tuple(layer.astype(np.float32) for layer in layers))


def make_optimiser(model: nn.Module, rate: float, decay: float) -> torch.optim.Optimizer:
    """Return the optimiser of all fits, AdamW (Loshchilov & Hutter 2019, arXiv:1711.05101).

    The fused one takes the processor's square root; the other one MKL's, whose last bit depends on the processor.
    """
    return torch.optim.AdamW(model.parameters(), lr=rate, weight_decay=decay, fused=True)


def _descend(model: nn.Sequential, x: Tensor, loss: Loss, schedule: Schedule) -> None:
    batch = min(schedule.batch, len(x))
    steps = schedule.epochs * (len(x) // batch)
    optimiser = make_optimiser(model, schedule.rate, schedule.decay)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps, eta_min=1e-5)
    for _ in range(schedule.epochs):
        for at in torch.randperm(len(x))[: len(x) // batch * batch].split(batch):
            optimiser.zero_grad()
            loss(model(x[at]), at).backward()
            optimiser.step()
            decay.step()


def average_networks(members: list[Network]) -> Network:
    """Return networks of the same features as one network whose outputs are their mean."""
    first, last = members[0], len(members[0].layers) - 1
    merged: list[np.ndarray] = []
    for depth, layers in enumerate(zip(*(member.layers for member in members), strict=True)):
        weights, offsets = [layer[:, :-1] for layer in layers], [layer[:, -1:] for layer in layers]
        if depth == last:
            merged.append(np.hstack([*weights, sum(offsets)]) / len(members))
        else:
            joined = np.concatenate(weights) if depth == 0 else _join_blocks(weights)
            merged.append(np.hstack([joined, np.concatenate(offsets)]))
    return Network(
        first.features, first.outputs, first.limits, tuple(layer.astype(np.float32) for layer in merged)
    )


def join_outputs(*networks: Network) -> Network:
    """Return networks of the same features, with one hidden layer each, as one network with all their outputs."""
    hidden, outputs = zip(*(network.layers for network in networks), strict=True)
    output = np.hstack(
        [
            _join_blocks([layer[:, :-1] for layer in outputs]),
            np.concatenate([layer[:, -1:] for layer in outputs]),
        ]
    )
    names = tuple(name for network in networks for name in network.outputs)
    first = networks[0]
    return Network(first.features, names, first.limits, (np.concatenate(hidden), output.astype(np.float32)))


def _join_blocks(blocks: list[np.ndarray]) -> np.ndarray:
    joined = np.zeros(
        (sum(len(block) for block in blocks), sum(block.shape[1] for block in blocks)), np.float32
    )
    row = column = 0
    for block in blocks:
        joined[row : row + len(block), column : column + block.shape[1]] = block
        row, column = row + len(block), column + block.shape[1]
    return joined
